"""Results that may lack parts, with a message for each missing one."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from motionkit.core.errors import MotionkitError

K = TypeVar("K")
T = TypeVar("T")


@dataclass(frozen=True)
class PartialResult(Generic[T]):
    """A value, and a message for each missing part."""

    value: T
    missing: tuple[str, ...] = ()


def collect(
    keys: Iterable[K],
    find: Callable[[K], T],
    label: Callable[[K], str] = str,
    errors: tuple[type[Exception], ...] = (MotionkitError,),
) -> PartialResult[dict[K, T]]:
    """Call `find` for every key; a key for which it raises one of `errors` is missing, as "label: error"."""
    found: dict[K, T] = {}
    missing: list[str] = []
    for key in keys:
        try:
            found[key] = find(key)
        except errors as error:
            missing.append(f"{label(key)}: {error}")
    return PartialResult(found, tuple(missing))
