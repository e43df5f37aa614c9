"""Functions that lie above the class whose methods call them, by the names that they are provided under.

`Motion` lies on the lowest floor and knows no other. What `motion.save`, `motion.resample` and a notebook's view of it
do is written above: `motionkit/__init__.py`, which runs before any module of motionkit, says where, and the function is
imported when the method is first called. So the methods are ordinary, typed ones of `Motion`, wherever a motion came
from, and no module here imports or names a package above it.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

_places: dict[str, str] = {}


def provide(**places: str) -> None:
    """Say where functions lie: `save="package.module:function"`."""
    _places.update(places)


def provided(name: str) -> Callable[..., Any]:
    """The function that was provided under a name; raises `KeyError` where none was."""
    module, _, function = _places[name].partition(":")
    found: Callable[..., Any] = getattr(import_module(module), function)
    return found
