"""Configurations are nested frozen dataclasses: to and from plain values, and changed by `a.b=c` overrides.

Field types may be bool, int, float, str, `Literal`, `T | None`, `tuple[T, ...]` and further dataclasses.
"""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, Protocol, TypeVar, runtime_checkable

from motionkit.core.errors import UsageError


@runtime_checkable
class ConfigLike(Protocol):
    """Any dataclass instance."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


# A setting that stages share: in which number format they multiply matrices (motionkit.training.precision).
Precision = Literal["auto", "float32", "tf32", "bfloat16"]

ConfigT = TypeVar("ConfigT", bound=ConfigLike)
T = TypeVar("T")


def to_plain(config: ConfigLike) -> dict[str, Any]:
    """A configuration as nested dictionaries, lists and scalars, ready for JSON."""
    return {field.name: _plain_value(getattr(config, field.name)) for field in dataclasses.fields(config)}


def from_plain(config_type: type[T], values: dict[str, Any]) -> T:
    """The inverse of `to_plain`; fields that are absent keep their defaults.

    Raises `UsageError` for a key that the dataclass doesn't have and for a value of another type.
    """
    hints = typing.get_type_hints(config_type)
    unknown = sorted(set(values) - set(config_type.__dataclass_fields__))  # type: ignore[attr-defined]
    if unknown:
        raise UsageError(f"{config_type.__name__} has no {', '.join(unknown)}; it has: {', '.join(sorted(hints))}")
    return config_type(**{name: _typed_value(value, hints[name], name) for name, value in values.items()})


def flatten(config: ConfigLike, prefix: str = "") -> dict[str, Any]:
    """All leaves by their dotted keys, in the order of declaration: {"field.steps": 2000, …}."""
    leaves: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            leaves |= flatten(value, f"{prefix}{field.name}.")
        else:
            leaves[prefix + field.name] = value
    return leaves


def parse_override(override: str) -> tuple[str, str]:
    """Split `a.b=c` into key and text; raises `UsageError` where there is no equals sign."""
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise UsageError(f"--set takes KEY=VALUE, not {override!r}")
    return key.strip(), text.strip()


def setting_text(value: Any) -> str:
    """A setting's value as `a.b=c` takes it: true, 20, 0.5, none, lists with commas."""
    if isinstance(value, tuple):
        return ",".join(map(setting_text, value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def unknown_setting(key: str, known: Sequence[str]) -> str:
    """What to say of a key that is no setting: first those that may have been meant, of a hundred that there are."""
    of_that_name = [each for each in known if each.rpartition(".")[2] == key.rpartition(".")[2]]
    meant = list(dict.fromkeys([*difflib.get_close_matches(key, known, n=3, cutoff=0.85), *of_that_name]))
    return f"no setting is called {key!r}" + (f", perhaps {' or '.join(meant)}" if meant else "")


def apply_overrides(config: ConfigT, overrides: Sequence[str]) -> ConfigT:
    """The configuration with all of `a.b=c` applied at once, so that settings which must agree can change together.

    The last one wins where a key comes twice. Raises `UsageError` for a key that doesn't exist (naming those that do),
    a value that its type can't be read from, or settings that the dataclass refuses together.
    """
    changes = dict(parse_override(override) for override in overrides)
    for key in changes:
        if key not in flatten(config):
            raise UsageError(f"{unknown_setting(key, list(flatten(config)))}; there are: {', '.join(flatten(config))}")
    return _replaced(config, changes, "")


def _replaced(config: ConfigT, changes: Mapping[str, str], prefix: str) -> ConfigT:
    hints = typing.get_type_hints(type(config))
    values: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        key, value = prefix + field.name, getattr(config, field.name)
        if key in changes:
            values[field.name] = _parse_text(changes[key], hints[field.name], key)
        elif any(changed.startswith(key + ".") for changed in changes):
            values[field.name] = _replaced(value, changes, key + ".")
    try:
        return dataclasses.replace(config, **values)
    except ValueError as error:
        told = ", ".join(f"{key}={text}" for key, text in changes.items() if key.startswith(prefix))
        raise UsageError(f"{told}: {error}") from None


def _plain_value(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return to_plain(value)
    if isinstance(value, tuple):
        return [_plain_value(item) for item in value]
    return value


def _typed_value(value: Any, annotation: Any, key: str) -> Any:
    """A JSON value as the annotated type."""
    if dataclasses.is_dataclass(annotation) and isinstance(annotation, type):
        if not isinstance(value, dict):
            raise UsageError(f"{key} must be a table of {annotation.__name__}, not {value!r}")
        return from_plain(annotation, value)
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        inner = next(argument for argument in arguments if argument is not types.NoneType)
        return None if value is None else _typed_value(value, inner, key)
    if origin is tuple and isinstance(value, list):
        return tuple(_typed_value(item, arguments[0], key) for item in value)
    if origin is Literal:
        if value in arguments:
            return value
    elif annotation is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    elif isinstance(annotation, type) and type(value) is annotation:
        return value
    raise UsageError(f"{key} must be {_describe(annotation)}, not {value!r}")


def _parse_text(text: str, annotation: Any, key: str) -> Any:
    """A value from the command line as the annotated type."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        inner = next(argument for argument in arguments if argument is not types.NoneType)
        return None if text.lower() in ("none", "null", "") else _parse_text(text, inner, key)
    if origin is tuple:
        return tuple(_parse_text(item.strip(), arguments[0], key) for item in text.split(",") if item.strip())
    if origin is Literal and text in arguments:
        return text
    if annotation is bool and text.lower() in ("true", "false"):
        return text.lower() == "true"
    if annotation is str:
        return text
    if annotation in (int, float):
        try:
            value = annotation(text)
        except ValueError:
            value = math.nan
        if math.isfinite(value):
            return value
    raise UsageError(f"{key} must be {_describe(annotation)}, not {text!r}")


def _describe(annotation: Any) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        return "one of " + ", ".join(str(argument) for argument in arguments)
    if origin is tuple:
        return f"a list of {_describe(arguments[0])}"
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
    return names.get(annotation, str(annotation))
