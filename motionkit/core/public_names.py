"""Lazy imports of a package's public names.

A package lists the modules of its names in its `__init__.py`:

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
    """A package that imports its names on first use."""

    _places: Mapping[str, str]

    def __getattr__(self, name: str) -> Any:
        # Only called for names that are not set yet.
        place = self.__dict__["_places"].get(name)
        if place is None:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        value = self.__dict__[name] = getattr(import_module(place), name)
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        # The import system binds submodules to their names in the package; public names take precedence.
        if not (name in self.__dict__["_places"] and isinstance(value, ModuleType)):
            super().__setattr__(name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        # Pickled like any module, since functions that use the package may be sent to workers.
        return import_module, (self.__name__,)

    def __dir__(self) -> list[str]:
        return sorted({*self.__dict__["_places"], *(name for name in self.__dict__ if name.startswith("__"))})


def give_names(package: str, places: Mapping[str, str]) -> None:
    """Make a package provide these names lazily; `places` maps each name to its module."""
    module = sys.modules[package]
    module.__dict__["_places"] = dict(places)
    module.__class__ = _Package


_places: dict[str, str] = {}


def provide(**places: str) -> None:
    """Register functions by location: `save="package.module:function"`."""
    _places.update(places)


def provided(name: str) -> Callable[..., Any]:
    """The function registered under a name; raises `KeyError` if there is none."""
    module, _, function = _places[name].partition(":")
    found: Callable[..., Any] = getattr(import_module(module), function)
    return found
