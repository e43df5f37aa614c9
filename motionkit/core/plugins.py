"""What installed packages add to motionkit: one entry point a package, in the group `motionkit.plugins`.

The entry point names a module with dictionaries from names to what the package adds (docs/extending.md): `COMMANDS`,
`STAGES`, `MODELS`, `ENCODERS`, `TEXT_ENCODERS`, `FORMATS`, `TABLES`, `PLANS`, `ABLATIONS`, and run folders (`RUNS`).
A value is an object, or its place "module:attribute", which is imported when it is used: so that module imports nothing
heavy, and names can be listed at once. `ALL` are the names of those stages that `motionkit train --stage all` trains.
The order is that of the entry points' names, motionkit's own first, and of the dictionaries.
"""

import sys
from collections.abc import Callable, Iterator
from functools import cache, reduce
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from types import ModuleType
from typing import Any, Literal

from motionkit.core.errors import MotionkitError

GROUP, OWN = "motionkit.plugins", "motionkit"
Training = Literal["ALL", "STAGES", "PLANS", "ABLATIONS", "RUNS"]
Kind = Training | Literal["COMMANDS", "MODELS", "ENCODERS", "TEXT_ENCODERS", "FORMATS", "TABLES"]


def names(kind: Kind) -> tuple[str, ...]:
    """All names of a kind; nothing but the packages' modules is imported."""
    return tuple(dict.fromkeys(name for values in listed(kind) for name in values))


def load(kind: Kind, name: str) -> Any:
    """What has this name.

    Raises `KeyError` if there is nothing, and `MotionkitError` if it may be in a package whose module cannot be
    imported.
    """
    for values in listed(kind):
        if name in values:
            return resolve(values[name])
    for entry in _entry_points():
        _module(entry)
    raise KeyError(name)


def load_all(kind: Kind, *, foreign: bool = False) -> dict[str, Any]:
    """All of a kind by name; with `foreign`, only what is not of motionkit's own packages."""
    found: dict[str, Any] = {}
    for values in listed(kind, foreign):
        found |= {name: resolve(value) for name, value in values.items() if name not in found}
    return found


def resolve(value: Any) -> Any:
    """A value of a package's list: the object itself, or the one at the place "module:attribute"."""
    if not isinstance(value, str):
        return value
    module, _, attributes = value.partition(":")
    return reduce(getattr, attributes.split("."), import_module(module))


def lazily(place: str) -> Callable[..., Any]:
    """The function "module:name", imported when it is called."""
    return lambda *arguments, **options: resolve(place)(*arguments, **options)


def listed(kind: Kind, foreign: bool = False) -> Iterator[Any]:
    """Each package's list of a kind; a package whose module cannot be imported is left out."""
    for entry in _entry_points():
        if foreign and _is_own(entry):
            continue
        try:
            module = _module(entry)
        except MotionkitError:
            continue
        yield getattr(module, kind, {})


def _entry_points() -> tuple[EntryPoint, ...]:
    return _entry_points_in(tuple(sys.path))


@cache
def _entry_points_in(folders: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Those of packages in `sys.path`, whose metadata takes a while to read."""
    return tuple(sorted(entry_points(group=GROUP), key=lambda entry: (not _is_own(entry), entry.name)))


def _is_own(entry: EntryPoint) -> bool:
    return entry.dist is not None and entry.dist.name == OWN


def _module(entry: EntryPoint) -> ModuleType:
    """A package's module; raises `MotionkitError`, since a repository's own package may shadow the installed one."""
    try:
        return import_module(entry.module)
    except Exception as error:
        package = entry.module.partition(".")[0]
        found = find_spec(package)
        raise MotionkitError(
            f"{entry.module} cannot be imported ({error}): Python finds {package!r} in "
            f"{found.origin if found else 'no folder'}; another project's? Leave its folder out of PYTHONPATH"
        ) from error
