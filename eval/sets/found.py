"""What could be had, beside why the rest could not: a value that functions return instead of a list they write into."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from motionkit.core.errors import MotionkitError

K = TypeVar("K")
T = TypeVar("T")


@dataclass(frozen=True)
class Found(Generic[T]):
    """A value, and a sentence for each thing that it lacks."""

    value: T
    missing: tuple[str, ...] = ()


def each_found(
    keys: Iterable[K],
    find: Callable[[K], T],
    label: Callable[[K], str] = str,
    refusals: tuple[type[Exception], ...] = (MotionkitError,),
) -> Found[dict[K, T]]:
    """`find` of every key; one that raises one of `refusals` is missing, as "label: error"."""
    found: dict[K, T] = {}
    missing: list[str] = []
    for key in keys:
        try:
            found[key] = find(key)
        except refusals as error:
            missing.append(f"{label(key)}: {error}")
    return Found(found, tuple(missing))
