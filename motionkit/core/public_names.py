"""Packages whose public names come from modules that are imported when a name is first used.

A package says in its `__init__.py` where its names lie:

    give_names(__name__, {"Store": "motionkit.store.reader"})

so that importing the package costs nothing (PEP 562), and a public name may be that of a subpackage:
`from package import name` is the function `name`, whatever has been imported before, and `from package.name import
module` finds the module. (`import package.name.module as module` does not, for Python then looks it up as an attribute
of the function.) Type checkers read the same names from imports under `if TYPE_CHECKING`.
"""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any


class _Package(ModuleType):
    """A package that imports what it is asked for."""

    _places: Mapping[str, str]

    def __getattr__(self, name: str) -> Any:
        # Python asks here only for what the package does not hold yet.
        place = self.__dict__["_places"].get(name)
        if place is None:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        value = self.__dict__[name] = getattr(import_module(place), name)
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        # The import system binds a submodule to its name in the package; a public name stays what it is.
        if not (name in self.__dict__["_places"] and isinstance(value, ModuleType)):
            super().__setattr__(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        # As any module travels: a function that uses the package may be sent to a worker.
        return import_module, (self.__name__,)

    def __dir__(self) -> list[str]:
        return sorted({*self.__dict__["_places"], *(name for name in self.__dict__ if name.startswith("__"))})


def give_names(package: str, places: Mapping[str, str]) -> None:
    """Let a package give each of these names from the module that defines it; `places` maps name to module."""
    module = sys.modules[package]
    module.__dict__["_places"] = dict(places)
    module.__class__ = _Package


_places: dict[str, str] = {}


def provide(**places: str) -> None:
    """Say where functions lie: `save="package.module:function"`."""
    _places.update(places)


def provided(name: str) -> Callable[..., Any]:
    """The function that was provided under a name; raises `KeyError` where none was."""
    module, _, function = _places[name].partition(":")
    found: Callable[..., Any] = getattr(import_module(module), function)
    return found
