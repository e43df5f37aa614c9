"""Configurations as nested frozen dataclasses: conversion to and from plain values, and `a.b=c` overrides.

Field types may be bool, int, float, str, `Literal`, `T | None`, `tuple[T, ...]` and further dataclasses; in plain
values also `int | float`, `Mapping[str, T]` and `Any`.
"""

import dataclasses
import difflib
import json
import math
import types
import typing
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Protocol, TypeVar, get_args, runtime_checkable

from motionkit.core.errors import UsageError


@runtime_checkable
class ConfigLike(Protocol):
    """Any dataclass instance."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


# The number format of matrix products (motionkit.training.networks).
Precision = Literal["auto", "float32", "bfloat16"]

ConfigT = TypeVar("ConfigT", bound=ConfigLike)
T = TypeVar("T")


def specialised(base: type[T], name: str, **parts: type) -> type[T]:
    """A configuration's type with these types of some parts, which are made with their defaults."""
    fields = [(part, kind, dataclasses.field(default_factory=kind)) for part, kind in parts.items()]
    return dataclasses.make_dataclass(name, fields, bases=(base,), frozen=True)


def require_positive(config: ConfigLike, *names: str) -> None:
    """Raise `ValueError` for settings that are not None and not positive."""
    for name in names:
        if (value := getattr(config, name)) is not None and not value > 0:
            raise ValueError(f"{name} must be positive, not {value}")


@dataclasses.dataclass(frozen=True)
class Schedule:
    """Number of steps, batch size in windows, and learning rate of a stage.

    Exactly one of `steps` and `epochs` must be given. The learning rate rises over `warmup_fraction` of the steps, then
    is constant or follows half a cosine to 0. With `kind="steps"` it is multiplied by `drop` after every `drop_every`
    share of the steps instead, without a warm-up.
    """

    steps: int | None = None
    epochs: int | None = None
    batch_size: int = 64
    learning_rate: float = 1e-4
    kind: Literal["constant", "cosine", "steps"] = "constant"
    warmup_fraction: float = 0.0
    drop: float = 0.5
    drop_every: float = 0.2

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.epochs is None):
            raise ValueError(f"exactly one of steps and epochs must be given, not {self.steps} and {self.epochs}")
        require_positive(self, "steps", "epochs", "batch_size", "learning_rate", "drop_every")

    def num_steps(self, visits: int | float) -> int:
        """Number of steps, with this many windows per epoch."""
        if self.steps is not None:
            return self.steps
        assert self.epochs is not None
        return max(1, math.ceil(self.epochs * visits / self.batch_size))

    def factor(self, step: int, steps: int) -> float:
        """The factor of the learning rate at a step."""
        if self.kind == "steps":
            return float(self.drop ** int(step / (self.drop_every * steps)))
        warmup_steps = round(self.warmup_fraction * steps)
        if step < warmup_steps:
            return (step + 1) / warmup_steps
        if self.kind == "constant":
            return 1.0
        return 0.5 * (1.0 + math.cos(math.pi * (step - warmup_steps) / max(1, steps - warmup_steps)))


def to_plain(config: ConfigLike) -> dict[str, Any]:
    """A configuration as nested dictionaries, lists and scalars, ready for JSON."""
    plain: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(config)))
    return plain


def from_plain(config_type: type[T], values: dict[str, Any]) -> T:
    """The inverse of `to_plain`; missing fields keep their defaults.

    Raises `UsageError` for an unknown key or a value of another type, `ValueError` for values that the configuration
    itself refuses.
    """
    hints = typing.get_type_hints(config_type)
    known = config_type.__dataclass_fields__  # type: ignore[attr-defined]
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise UsageError(f"{config_type.__name__} has no {', '.join(unknown)}; it has: {', '.join(sorted(known))}")
    return config_type(**{name: _converted(value, hints[name], name) for name, value in values.items()})


def flatten(config: ConfigLike) -> dict[str, Any]:
    """All leaves by their dotted keys, in the order of declaration: {"field.schedule.steps": 2000, …}."""
    return leaves(dataclasses.asdict(config))


def leaves(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested values by their dotted keys."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat |= leaves(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


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


def unknown_setting(key: str, configs: Sequence[ConfigLike]) -> str:
    """The message for an unknown key, with similar ones."""
    known = list(dict.fromkeys(setting for config in configs for setting in flatten(config)))
    same_name = [each for each in known if each.rpartition(".")[2] == key.rpartition(".")[2]]
    similar = list(dict.fromkeys([*difflib.get_close_matches(key, known, n=3, cutoff=0.85), *same_name]))
    return f"no setting is called {key!r}" + (f", perhaps {' or '.join(similar)}" if similar else "")


def apply_overrides(config: ConfigT, overrides: Sequence[str]) -> ConfigT:
    """The configuration with all of `a.b=c` applied at once, so that settings which must agree can change together.

    The last of repeated keys wins. Raises `UsageError` for an unknown key (listing the known ones), an invalid value,
    or an invalid combination of settings.
    """
    changes = dict(parse_override(override) for override in overrides)
    for key in changes:
        if key not in flatten(config):
            raise UsageError(f"{unknown_setting(key, [config])}; there are: {', '.join(flatten(config))}")
    return _replaced(config, changes, "")


def _replaced(config: ConfigT, changes: Mapping[str, str], prefix: str) -> ConfigT:
    hints = typing.get_type_hints(type(config))
    values: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        key = prefix + field.name
        if key in changes:
            values[field.name] = _converted(changes[key], hints[field.name], key)
        elif any(changed.startswith(key + ".") for changed in changes):
            values[field.name] = _replaced(getattr(config, field.name), changes, key + ".")
    try:
        return dataclasses.replace(config, **values)
    except ValueError as error:
        settings = ", ".join(f"{key}={text}" for key, text in changes.items() if key.startswith(prefix))
        raise UsageError(f"{settings}: {error}") from None


def _converted(value: Any, annotation: Any, key: str) -> Any:
    """A JSON value, or an override's text, as the annotated type; raises `UsageError` that names key and type."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    text = value if isinstance(value, str) else None
    if annotation is Any or (type(value) in (int, float) and type(value) in arguments):
        return value
    if origin is Mapping and isinstance(value, dict):
        return {name: _converted(item, arguments[1], f"{key}.{name}") for name, item in value.items()}
    if origin in (typing.Union, types.UnionType):
        kind = next(argument for argument in arguments if argument is not types.NoneType)
        is_none = value is None or (text is not None and text.lower() in ("none", "null", ""))
        return None if is_none else _converted(value, kind, key)
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation) and isinstance(value, dict):
        return from_plain(annotation, value)
    if origin is tuple and text is not None:
        value = [item.strip() for item in text.split(",") if item.strip()]
    if origin is tuple and isinstance(value, list):
        return tuple(_converted(item, arguments[0], key) for item in value)
    if annotation is bool and text is not None:
        value = {"true": True, "false": False}.get(text.lower(), text)
    if annotation in (int, float) and text is not None:
        with suppress(ValueError):
            value = annotation(text) if math.isfinite(float(text)) else text
    if annotation is float and type(value) is int:
        return float(value)
    if value in arguments if origin is Literal else type(value) is annotation:
        return value
    raise UsageError(f"{key} must be {_described(annotation)}, not {value!r}")


def _described(annotation: Any) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        return "one of " + ", ".join(map(str, arguments))
    if origin is tuple:
        return f"a list of {_described(arguments[0])}"
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
    return names.get(annotation) or f"a table of {getattr(annotation, '__name__', 'values')}"


NoiseSchedule = Literal["scaled_linear", "cosine"]
Prediction = Literal["noise", "latent", "velocity"]
Sampler = Literal["ddim", "ddpm"]
SAMPLERS: tuple[Sampler, ...] = get_args(Sampler)


@dataclass(frozen=True)
class DiffusionConfig:
    """The process, the network's prediction, and the sampler; the defaults are the paper's (Eq. 5, B.1).

    The paper's "scaled linearly" is linear in √β, as in latent diffusion models; "cosine" is Nichol & Dhariwal's
    (2021), which ignores `beta_start` and `beta_end`. `prediction` is the network's output, whose squared error is
    minimised: the noise ε (the paper), the clean latent z, or the velocity √ᾱ ε − √(1 − ᾱ) z (Salimans & Ho 2022).

    With `sampling_spacing` "trailing" inference starts at the noisiest step, which z_K ~ N(0, I) corresponds to;
    "leading" (offset 1) starts up to num_steps / sampling_steps earlier, as in motion-latent-diffusion.
    `guidance_scale` is r of Eq. 6.
    """

    num_steps: int = 1000
    schedule: NoiseSchedule = "scaled_linear"
    beta_start: float = 8.5e-4
    beta_end: float = 0.012
    prediction: Prediction = "noise"
    sampler: Sampler = "ddim"
    sampling_steps: int = 50
    sampling_spacing: Literal["trailing", "leading"] = "trailing"
    guidance_scale: float = 7.5

    def __post_init__(self) -> None:
        if not 0 < self.beta_start <= self.beta_end < 1:
            raise ValueError(f"betas must rise inside (0, 1), not from {self.beta_start} to {self.beta_end}")
        if not 1 <= self.sampling_steps <= self.num_steps:
            raise ValueError(f"sampling_steps must lie in 1 … {self.num_steps}, not {self.sampling_steps}")

    def adjusted(self, sampler: str | None, steps: int | None, guidance_scale: float | None) -> "DiffusionConfig":
        """These settings with other sampling options (None: unchanged); raises `UsageError` for invalid ones."""
        steps = self.sampling_steps if steps is None else steps
        if not 1 <= steps <= self.num_steps:
            raise UsageError(f"{steps} sampling steps: this model's diffusion has 1 … {self.num_steps}")
        chosen = next((each for each in SAMPLERS if each == (sampler or self.sampler)), None)
        if chosen is None:
            raise UsageError(f"no sampler is called {sampler!r}; there are {', '.join(SAMPLERS)}")
        scale = self.guidance_scale if guidance_scale is None else guidance_scale
        if not math.isfinite(scale):
            raise UsageError(f"a guidance scale must be a finite number (1: no guidance), not {scale}")
        return replace(self, sampler=chosen, sampling_steps=steps, guidance_scale=scale)
