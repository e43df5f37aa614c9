"""`samples.toml`: metadata that the files of a folder of samples lack (docs/samples.md)."""

import os
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path, PurePath
from typing import Any

from motionkit.core.errors import FormatError, describe, shown
from motionkit.core.files import parse_toml
from motionkit.core.timegrid import parse_fps
from motionkit.io import source_file
from motionkit.io.body_frame import GIVEN_AXES

MANIFEST = "samples.toml"
RAW, NORMALISED = "raw", "normalised"
CHOICES = {"up": GIVEN_AXES, "statistics": (RAW, NORMALISED)}


@dataclass(frozen=True)
class Manifest:
    """A folder's `samples.toml`; every key is optional if the files state it.

    `files` and `exclude` are globs below the folder. `fps` and `unit_metres` override the files; `up` is the vertical
    axis. `statistics` is `raw` or `normalised` for pose vectors, `mean` and `std` the .npy files they were normalised
    with. `prompts` is a text file whose line k (from 0) is the caption of group k.
    """

    files: tuple[str, ...] = ()
    exclude: tuple[str, ...] | None = None
    fps: Fraction | None = None
    unit_metres: float | None = None
    up: str = ""
    statistics: str = ""
    mean: Path | None = None
    std: Path | None = None
    prompts: Path | None = None


def read_manifest(folder: Path) -> Manifest:
    """Read `folder/samples.toml`, whose paths may not leave the folder; an absent one is like an empty one.

    Raises `FormatError` (`manifest`).
    """
    path = folder / MANIFEST
    if not path.is_file() or not path.stat().st_size:
        return Manifest()

    def fault(message: str) -> FormatError:
        return FormatError(message[:400], path=path, reason="manifest")

    try:
        stated = parse_toml(source_file.decode(source_file.read_bytes(path), path))
    except ValueError as error:
        raise fault(f"not TOML ({error})") from None
    known = [field.name for field in fields(Manifest)]
    values: dict[str, Any] = {}
    for key, value in stated.items():
        if key not in known:
            raise fault(f"unknown key {shown(key)}, expected any of {', '.join(known)}")
        try:
            values[key] = _value(key, value, folder)
        except (ValueError, TypeError, OSError) as error:
            raise fault(f"{key} = {shown(value)}: {describe(error)}") from None
    manifest = Manifest(**values)
    if (manifest.statistics == NORMALISED) != (manifest.mean is not None and manifest.std is not None):
        raise fault(
            'statistics = "normalised" needs mean = "….npy" and std = "….npy", the files that the model was '
            "trained with, and they need it"
        )
    return manifest


def _value(key: str, value: Any, folder: Path) -> Any:
    """The value of one key; raises `ValueError`, `TypeError` or `OSError` that says what was expected."""
    match key:
        case "fps":
            if type(value) not in (int, float, str):
                raise TypeError('expected a framerate such as 20, 12.5 or "30000/1001"')
            return parse_fps(value)
        case "unit_metres":
            if type(value) not in (int, float) or not 0 < value < 1e6:
                raise TypeError("expected the length of the files' unit in metres, such as 0.01")
            return float(value)
        case "files" | "exclude":
            globs = [value] if isinstance(value, str) else value
            if not isinstance(globs, list) or not all(isinstance(glob, str) and glob for glob in globs):
                raise TypeError('expected a glob or a list of globs, such as ["*_pred.npy"]')
            # A glob matches the end of a path, whatever the folders before it.
            globs = [glob.removeprefix("**/") for glob in globs]
            for glob in globs:
                PurePath().match(glob)  # raises ValueError for an empty one
            return tuple(globs)
        case "up" | "statistics":
            if value not in CHOICES[key]:
                raise ValueError(f"expected {' or '.join(map(repr, CHOICES[key]))}")
            return value
    if not isinstance(value, str):
        raise TypeError("expected the name of a file in this folder")
    path = Path(os.path.normpath(folder / value))
    if not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise ValueError("leaves the folder; copy the file here")
    if not path.is_file():
        raise ValueError("there is no such file in this folder; copy it here")
    return path


def read_prompts(path: Path) -> tuple[str, ...]:
    """Captions of a text file, one per line; text after a `#` (a length, HumanML3D's tokens) is dropped."""
    lines = source_file.decode(source_file.read_bytes(path), path).splitlines()
    return tuple(line.split("#")[0].strip() for line in lines)
