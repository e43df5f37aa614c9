"""`samples.toml`: metadata that the files of a folder of samples lack (docs/samples.md)."""

import json
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import Any

from motionkit.core.errors import FormatError, describe, shown
from motionkit.core.files import parse_toml
from motionkit.core.timegrid import parse_fps
from motionkit.io import source_file
from motionkit.io.body_frame import GIVEN_AXES

NAME_FIELDS = {
    **dict.fromkeys(("group", "caption", "action"), ".+?"),
    **dict.fromkeys(("repeat", "num_frames"), r"\d+"),
}
"""What file names may say, and the regular expression of each; {any} is anything, and may occur once, too."""
LONGEST_PATTERN = 1000


def name_expression(text: str) -> re.Pattern[str]:
    """The regular expression of a name pattern such as "sample{group}_repeat{repeat}_len{num_frames}".

    Raises `ValueError` for unknown or repeated fields, and more than 1,000 letters.
    """
    if len(text) > LONGEST_PATTERN:
        raise ValueError(f"{len(text):,} letters, expected at most {LONGEST_PATTERN:,}")
    literals, fields = (parts := re.split(r"\{(\w*)\}", text))[::2], parts[1::2]
    expression = re.escape(literals[0])
    for number, field in enumerate(fields):
        if field not in (*NAME_FIELDS, "any"):
            known = ", ".join(f"{{{name}}}" for name in (*NAME_FIELDS, "any"))
            raise ValueError(f"unknown field {{{field}}}, expected {known}")
        if field in fields[:number]:
            raise ValueError(f"the field {{{field}}} occurs twice")
        expression += ".*?" if field == "any" else f"(?P<{field}>{NAME_FIELDS[field]})"
        expression += re.escape(literals[number + 1])
    return re.compile(expression)


MANIFEST = "samples.toml"
RAW, NORMALISED = "raw", "normalised"


@dataclass(frozen=True)
class SampleOptions:
    """Options for all folders of samples; `fps` and `up` (x, y or z) hold where nothing in a folder states them.

    `fps_option` is the name of its option, for messages. `keep_published` keeps pose vectors and KIT-ML's 21 joints
    beside the 22 joints, for evaluators that read these: up to five times the memory.
    """

    fps: Fraction | None = None
    fps_option: str = "--samples-fps"
    up: str = ""
    keep_published: bool = False


@dataclass(frozen=True)
class Manifest:
    """A folder's `samples.toml`; every key is optional if the files state it.

    `files` and `exclude` are globs below the folder. `fps` and `unit_metres` override the files; `up` is the vertical
    axis. `statistics` is `raw` or `normalised` for pose vectors, `mean` and `std` the .npy files they were normalised
    with. `name` is the pattern of file names: `"sample{group}_repeat{repeat}_len{num_frames}"`.
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
    name: re.Pattern[str] | None = None
    prompts: Path | None = None


def read_manifest(folder: Path) -> Manifest:
    """Read `folder/samples.toml`; an absent one is like an empty one. Raises `FormatError` (`manifest`).

    Paths in it are relative to the folder and may not leave it.
    """
    path = folder / MANIFEST
    if not path.is_file() or not path.stat().st_size:
        return Manifest()
    try:
        stated = parse_toml(source_file.decode(source_file.read_bytes(path), path))
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
            'statistics = "normalised" needs mean = "….npy" and std = "….npy", the files that the model was '
            "trained with, and they need it",
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
        PurePosixPath().match(str(_relative(glob)))  # which refuses an empty one
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
    # Paths from a file's content must stay inside the folder.
    relative = PurePosixPath(name.replace("\\", "/"))
    if "\0" in name or relative.is_absolute() or ".." in relative.parts:
        raise ValueError("leaves the folder; expected a path inside it")
    return relative


def _name(value: Any, folder: Path) -> re.Pattern[str]:
    if not isinstance(value, str) or not value:
        raise TypeError('expected a pattern such as "sample{group}_repeat{repeat}"')
    return name_expression(value)


READERS: dict[str, Callable[[Any, Path], Any]] = {
    "fps": _fps,
    "files": _globs,
    "exclude": _globs,
    "unit_metres": _unit,
    "up": _one_of(*GIVEN_AXES),
    "statistics": _one_of(RAW, NORMALISED),
    "mean": _file,
    "std": _file,
    "name": _name,
    "prompts": _file,
}
EXPLAINED = {
    "fps": ("20", 'framerate: 20, 12.5, "30000/1001"'),
    "files": ('["**/*_pred.npy"]', "which files are samples; all motions there are, without this line"),
    "exclude": ('["old/*"]', "which are not"),
    "unit_metres": ("0.01", "how long the files' unit is; they are in metres without this line"),
    "up": ('"z"', "the axis bodies stand along; found by looking at most of them without this line"),
    "statistics": ('"raw"', 'of pose vectors (263 or 251 numbers): "raw", or "normalised" with mean and std'),
    "mean": ('"mean.npy"', "what they were normalised with, copied into this folder"),
    "std": ('"std.npy"', "the same"),
    "name": ('"sample{group}_repeat{repeat}"', "what names say: group, repeat, caption, action, num_frames, any"),
    "prompts": ('"prompts.txt"', "line k, from 0, is the caption of group k"),
}


def manifest_text(values: Mapping[str, object]) -> str:
    """A `samples.toml` with these values; every other key is included as an explained comment."""
    rows = [
        "# What the motions in this folder are. Lines that begin with # are not set; docs/samples.md explains them."
    ]
    for key, (example, purpose) in EXPLAINED.items():
        value = values.get(key)
        if isinstance(value, Fraction):
            value = value.numerator if value.denominator == 1 else str(value)
        # JSON's strings, numbers and lists are TOML's.
        stated = f"# {key} = {example}" if value is None else f"{key} = {json.dumps(value, ensure_ascii=False)}"
        rows.append(f"{stated:<44}  # {purpose}")
    return "\n".join(rows) + "\n"


# MDM's sample00_rep02, MoMask's sample3_repeat0_len196.
PUBLISHED_NAME = re.compile(r"sample_?(?P<group>\d+)_rep(?:eat)?_?\d+(?:_len\d+)?(?:_ik)?")


def named_fields(path: Path, manifest: Manifest) -> dict[str, str]:
    """What a file's name says by the manifest's pattern, or a published one.

    Raises `FormatError` (`name`) for a name that does not fit the manifest's.
    """
    match = (manifest.name or PUBLISHED_NAME).fullmatch(path.stem)
    if match is None:
        if manifest.name is None:
            return {}
        raise FormatError(f"its name does not fit the pattern of {MANIFEST}", path=path, reason="name")
    return {
        field: text.replace("_", " ").strip() if field in ("caption", "action") else text
        for field, text in match.groupdict().items()
    }


def read_prompts(path: Path) -> tuple[str, ...]:
    """Captions of a text file, one per line; text after a `#` (a length, HumanML3D's tokens) is dropped."""
    lines = source_file.decode(source_file.read_bytes(path), path).splitlines()
    return tuple(line.split("#")[0].strip() for line in lines)
