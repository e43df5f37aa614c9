"""`samples.toml`: what a folder of samples cannot say by itself (docs/samples.md)."""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import Any

from eval.sample_folder.name_pattern import NamePattern, parse_name_pattern
from motionkit.errors import FormatError, describe
from motionkit.formats import sourcefile
from motionkit.formats.globs import parse_glob
from motionkit.plain_text import parse_toml, shown
from motionkit.timegrid import parse_fps

MANIFEST = "samples.toml"
RAW, NORMALISED = "raw", "normalised"


@dataclass(frozen=True)
class SampleOptions:
    """What the command line says about all folders of samples: `fps` where nothing else does.

    `fps_option` is the option that says it, for messages. `keep_published` keeps pose vectors and KIT-ML's 21 joints
    beside the 22 joints made of them, for evaluators that read these: up to five times the memory.
    """

    fps: Fraction | None = None
    fps_option: str = "--samples-fps"
    keep_published: bool = False


@dataclass(frozen=True)
class Manifest:
    """What a folder's `samples.toml` says; every key may be left out where the files say it.

    `files` and `exclude` are globs below the folder. `fps` and `unit_metres` replace what files say; `up` is the axis
    that bodies stand along. `statistics` is `raw` or `normalised` for pose vectors, `mean` and `std` the .npy files
    they were normalised with. `name` says what a file's name holds: `"sample{group}_repeat{repeat}_len{num_frames}"`.
    `prompts` is a text file whose line k (from 0) is the caption of group k.
    """

    files: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    fps: Fraction | None = None
    unit_metres: float | None = None
    up: str = ""
    statistics: str = ""
    mean: Path | None = None
    std: Path | None = None
    name: NamePattern | None = None
    prompts: Path | None = None


def read_manifest(folder: Path) -> Manifest:
    """Read `folder/samples.toml`; an absent or empty one says nothing. Raises `FormatError` (`manifest`).

    Paths in it count from the folder and may not leave it.
    """
    path = folder / MANIFEST
    if not path.is_file() or not path.stat().st_size:
        return Manifest()
    try:
        stated = parse_toml(sourcefile.decode(sourcefile.read_bytes(path), path))
    except ValueError as error:
        raise FormatError(f"not TOML ({error})", path=path, reason="manifest") from None
    unknown = sorted(stated.keys() - READERS.keys())
    if unknown:
        raise FormatError(
            f"unknown key {shown(unknown[0])}, expected any of {', '.join(READERS)}", path=path, reason="manifest"
        )
    values: dict[str, Any] = {}
    for key, value in stated.items():
        try:
            values[key] = READERS[key](value, folder)
        except (ValueError, TypeError, OSError) as error:
            raise FormatError(
                f"{key} = {shown(value)}: {describe(error)}"[:400], path=path, reason="manifest"
            ) from None
    manifest = Manifest(**values)
    if (manifest.statistics == NORMALISED) != (manifest.mean is not None and manifest.std is not None):
        raise FormatError(
            'statistics = "normalised" goes with mean = "….npy" and std = "….npy", the files that the model was '
            "trained with, and only that goes with them",
            path=path,
            reason="manifest",
        )
    return manifest


def _fps(value: Any, folder: Path) -> Fraction:
    if not isinstance(value, (int, float, str)) or isinstance(value, bool):
        raise TypeError('expected a framerate such as 20, 12.5 or "30000/1001"')
    return parse_fps(value)


def _globs(value: Any, folder: Path) -> tuple[str, ...]:
    globs = [value] if isinstance(value, str) else value
    if not isinstance(globs, list) or not all(isinstance(glob, str) and glob for glob in globs):
        raise TypeError('expected a glob or a list of globs, such as ["*_pred.npy"]')
    for glob in globs:
        _relative(glob)
        parse_glob(glob)
    return tuple(globs)


def _unit(value: Any, folder: Path) -> float:
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0 < value < 1e6:
        raise TypeError("expected the length of the files' unit in metres, such as 0.01")
    return float(value)


def _one_of(*known: str) -> Callable[[Any, Path], str]:
    def read(value: Any, folder: Path) -> str:
        if value not in known:
            raise ValueError(f"expected {' or '.join(repr(word) for word in known)}")
        return str(value)

    return read


def _file(value: Any, folder: Path) -> Path:
    if not isinstance(value, str):
        raise TypeError("expected the name of a file in this folder")
    path = Path(os.path.normpath(folder / _relative(value)))
    if not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise ValueError("a link that leaves the folder; copy the file here")
    if not path.is_file():
        raise ValueError("there is no such file in this folder; copy it here")
    return path


def _relative(name: str) -> PurePosixPath:
    # A path from a file's content is used only where it stays inside the folder.
    relative = PurePosixPath(name.replace("\\", "/"))
    if "\0" in name or relative.is_absolute() or ".." in relative.parts:
        raise ValueError("leaves the folder; expected a path inside it")
    return relative


def _name(value: Any, folder: Path) -> NamePattern:
    if not isinstance(value, str) or not value:
        raise TypeError('expected a pattern such as "sample{group}_repeat{repeat}"')
    return parse_name_pattern(value)


READERS: dict[str, Callable[[Any, Path], Any]] = {
    "files": _globs,
    "exclude": _globs,
    "fps": _fps,
    "unit_metres": _unit,
    "up": _one_of("y", "z"),
    "statistics": _one_of(RAW, NORMALISED),
    "mean": _file,
    "std": _file,
    "name": _name,
    "prompts": _file,
}
assert READERS.keys() == {field.name for field in fields(Manifest)}


def manifest_text(values: Mapping[str, object]) -> str:
    """A `samples.toml` with these values; every other key stands in it as a comment that says what it is for."""
    rows = []
    for key, (example, purpose) in EXPLAINED.items():
        stated = f"{key} = {_toml(values[key])}" if key in values else f"# {key} = {example}"
        rows.append(f"{stated:<44}  # {purpose}")
    head = (
        "# What the motions in this folder are. Lines that begin with # are not set; docs/samples.md explains them.\n"
    )
    return head + "\n".join(rows) + "\n"


def _toml(value: object) -> str:
    if isinstance(value, Fraction):
        return str(value) if value.denominator == 1 else f'"{value}"'
    # JSON's strings, numbers and lists are TOML's.
    return json.dumps(value, ensure_ascii=False)


EXPLAINED = {
    "fps": ("20", 'framerate: 20, 12.5, "30000/1001"'),
    "files": ('["**/*_pred.npy"]', "which files are samples; all motions there are, without this line"),
    "exclude": ('["old/*"]', "which are not"),
    "unit_metres": ("0.01", "how long the files' unit is; they are in metres without this line"),
    "up": ('"z"', "the axis bodies stand along; found by looking at most of them without this line"),
    "statistics": ('"raw"', 'of pose vectors (263 or 251 numbers): "raw", or "normalised" with mean and std'),
    "mean": ('"mean.npy"', "what they were normalised with, copied into this folder"),
    "std": ('"std.npy"', "the same"),
    "name": (
        '"sample{group}_repeat{repeat}"',
        "what names say: group, repeat, caption, action, num_frames, any",
    ),
    "prompts": ('"prompts.txt"', "line k, from 0, is the caption of group k"),
}
assert EXPLAINED.keys() == READERS.keys()
