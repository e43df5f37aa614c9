"""Default paths: command-line option, then environment variable, then motionkit.toml, then ./name."""

import os
from pathlib import Path
from typing import Any

from motionkit.core.errors import UsageError
from motionkit.core.plain_text import parse_toml, shown

KEYS = ("store", "runs", "results")
OPTIONAL_KEYS = ("body_models", "cache")
FILE = Path("motionkit.toml")


def default_path(key: str) -> Path:
    """Default path of `store`, `runs` or `results`, relative to the current folder.

    Raises `UsageError` for a motionkit.toml that is not TOML, or has another value than a path.
    """
    if key not in KEYS:
        raise KeyError(key)
    return _stated_path(key) or Path(key)


def optional_path(key: str) -> Path | None:
    """Path of `body_models` or `cache` from the environment or motionkit.toml, or None; raises as `default_path`."""
    if key not in OPTIONAL_KEYS:
        raise KeyError(key)
    return _stated_path(key)


def _stated_path(key: str) -> Path | None:
    from_environment = os.environ.get(f"MOTIONKIT_{key.upper()}")
    if from_environment:
        return Path(from_environment)
    value = read_settings().get(key)
    if value is not None and (not isinstance(value, str) or "\0" in value):
        raise UsageError(f"{FILE}: {key} must be a path in quotes, not {shown(value)}")
    return None if value is None else Path(value)


def read_settings() -> dict[str, Any]:
    """The content of motionkit.toml in the current folder, empty if absent; raises `UsageError` if it is not TOML."""
    if not FILE.is_file():
        return {}
    try:
        return parse_toml(FILE.read_text(encoding="utf-8"))
    except ValueError as error:
        raise UsageError(f"{FILE}: {error}") from None
