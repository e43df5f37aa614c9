"""Where things lie by default: command-line option, then environment variable, then motionkit.toml, then ./name."""

import os
import tomllib
from pathlib import Path

from motionkit.errors import UsageError

KEYS = ("store", "runs", "results")


def default_path(key: str) -> Path:
    """Default path of `store`, `runs` or `results`, seen from the current folder.

    Raises `UsageError` for a motionkit.toml that is not TOML, or says something else than a path.
    """
    if key not in KEYS:
        raise KeyError(key)
    from_environment = os.environ.get(f"MOTIONKIT_{key.upper()}")
    if from_environment:
        return Path(from_environment)
    config = Path("motionkit.toml")
    if config.is_file():
        try:
            value = tomllib.loads(config.read_text(encoding="utf-8")).get(key)
        except ValueError as error:
            raise UsageError(f"{config}: {error}") from None
        if value is not None:
            if not isinstance(value, str):
                raise UsageError(f"{config}: {key} must be a path in quotes, not {value!r}")
            return Path(value)
    return Path(key)
