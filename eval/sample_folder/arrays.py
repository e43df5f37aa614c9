"""Motions in other systems' numpy files: any unambiguous order of axes, batches, dictionaries.

An array is joint positions (21, 22, 24 or 52 joints) with frames first (`[T, J, 3]`) or last (`[J, 3, T]`), or pose
vectors of 263 or 251 numbers (`[T, D]`, or `[D, 1, T]`), or a batch of these. J · 3 beside the 3 tells joint axes
apart: the 3 stands last or before last.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import FormatError, shown
from motionkit.core.timegrid import parse_fps
from motionkit.io import npy, source_file

JOINTS = frozenset({21, 22, 24, 52})
WIDTHS = frozenset({251, 263})
MOTION_KEYS = ("motion", "motions", "joints", "joint_positions")
TEXT_KEYS = ("text", "texts", "captions", "caption")
ACTION_KEYS = ("action_text", "action")
EXPECTED = (
    "expected frames × joints × 3 or joints × 3 × frames (21, 22, 24 or 52 joints), frames × 263 or 251 pose "
    'vectors, or a batch of these; for vectors of 135 or 276 numbers samples.toml says vectors = "motion-135", '
    '"flowmdm-135", "dart-276" or "vimogen-276"'
)


@dataclass(frozen=True, eq=False)
class StoredMotion:
    """One motion of a file: `numbers` are joints [T, J, 3] or pose vectors [T, D], a view if possible.

    `index` is its index in a batch, None for a file with one motion.
    """

    numbers: np.ndarray
    index: int | None = None
    caption: str = ""
    action: str = ""
    group: str = ""
    fps: Fraction | None = None


def read_stored(path: Path) -> list[StoredMotion]:
    """All motions of a .npy or .npz file. Raises `FormatError` for files without any; NaN is not checked."""
    data = source_file.read_bytes(path)
    content = _archive(path, data) if path.suffix.lower() == ".npz" else npy.read_object(path, data)
    if isinstance(content, np.ndarray):
        content = {"motion": content}
    if not isinstance(content, dict):
        raise FormatError("expected an array, or a dictionary of named arrays", path=path, reason="not-a-number")
    array = next((content[key] for key in MOTION_KEYS if isinstance(content.get(key), np.ndarray)), None)
    if array is None:
        held = ", ".join(sorted(map(str, content)))[:200] or "no known key"
        message = f"no array 'motion'; it holds {held} (docs/samples.md says how to export)"
        raise FormatError(message, path=path, reason="missing-key")
    if array.dtype.kind not in npy.NUMBERS:
        raise FormatError(f"array of {str(array.dtype)[:40]}, expected numbers", path=path, reason="not-a-number")
    motions = split_motions(array, path)
    lengths = _lengths(content.get("lengths"), len(motions), len(motions[0]), path)
    captions, actions = (_texts(content, keys, len(motions), path) for keys in (TEXT_KEYS, ACTION_KEYS))
    groups, fps = _groups(content, len(motions), path), _fps(content.get("fps"), path)
    each = zip(motions, lengths, captions, actions, groups, strict=True)
    return [
        StoredMotion(numbers[:length], None if len(motions) == 1 else index, caption, action, group, fps)
        for index, (numbers, length, caption, action, group) in enumerate(each)
    ]


def split_motions(array: np.ndarray, path: Path) -> list[np.ndarray]:
    """Motions [T, J, 3] or [T, D] in an array, frames first.

    Raises `FormatError` (`channel-count`, `no-frames`) for other shapes.
    """
    if 0 in array.shape:
        raise FormatError(f"array of shape {array.shape}, expected at least one frame", path=path, reason="no-frames")
    match array.shape:
        case (_, width) if width in WIDTHS:
            return [array]
        case (_, joints, 3) if joints in JOINTS:
            return [array]
        case (joints, 3, _) if joints in JOINTS:
            return [array.transpose(2, 0, 1)]
        case (_, _, width) if width in WIDTHS:
            return list(array)
        case (width, 1, _) if width in WIDTHS:
            return [array[:, 0].T]
        case (_, _, joints, 3) if joints in JOINTS:
            return list(array)
        case (_, joints, 3, _) if joints in JOINTS:
            return list(array.transpose(0, 3, 1, 2))
        case (_, width, 1, _) if width in WIDTHS:
            return list(array[:, :, 0].transpose(0, 2, 1))
    raise FormatError(f"array of shape {array.shape}, {EXPECTED}", path=path, reason="channel-count")


def _archive(path: Path, data: bytes) -> dict[str, Any]:
    """The known members of an .npz file: arrays unchanged, texts as lists."""
    archive = npy.open_archive(path, data)
    return {
        **{key: list(archive.strings(key)) for key in (*TEXT_KEYS, *ACTION_KEYS) if key in archive},
        **{key: archive.array(key) for key in (*MOTION_KEYS, "lengths") if key in archive},
        **{key: archive.scalar(key) for key in ("num_samples", "num_repetitions", "fps") if key in archive},
    }


def _lengths(stated: Any, count: int, frames: int, path: Path) -> list[int]:
    """The number of frames of each motion of a batch without padding."""
    lengths = stated.ravel().tolist() if isinstance(stated, np.ndarray) else stated
    if lengths is None:
        return [frames] * count
    is_listed = isinstance(lengths, (list, tuple)) and len(lengths) == count
    if not is_listed or any(each not in range(1, frames + 1) for each in lengths):
        message = f"lengths {shown(lengths)}, expected {count} whole numbers from 1 to {frames}"
        raise FormatError(message, path=path, reason="lengths")
    return list(map(int, lengths))


def _texts(content: Mapping[str, Any], keys: Sequence[str], count: int, path: Path) -> list[str]:
    """A text for each motion, "" without any."""
    values = next((content[key] for key in keys if content.get(key) is not None), [""] * count)
    values = values.tolist() if isinstance(values, np.ndarray) else [values] if isinstance(values, str) else values
    is_listed = isinstance(values, (list, tuple)) and len(values) == count
    if not is_listed or not all(isinstance(value, (str, int, float)) for value in values):
        message = f"{' or '.join(keys)}: {shown(values)}, expected {count} texts"
        raise FormatError(message, path=path, reason="text")
    return [value if isinstance(value, str) else shown(value) for value in values]


def _groups(content: Mapping[str, Any], count: int, path: Path) -> list[str]:
    """The prompt of each motion by MDM's order: motion r · num_samples + s is repetition r of prompt s.

    See sample/generate.py of motion-diffusion-model.
    """
    samples, repetitions = content.get("num_samples"), content.get("num_repetitions")
    if samples is None or repetitions is None:
        return [""] * count
    whole = isinstance(samples, int) and isinstance(repetitions, int)
    if not whole or samples < 1 or samples * repetitions != count:
        message = f"{shown(samples)} samples × {shown(repetitions)} repetitions for {count} motions"
        raise FormatError(message, path=path, reason="channel-count")
    return [str(index % samples) for index in range(count)]


def _fps(stated: Any, path: Path) -> Fraction | None:
    try:
        if stated is None or isinstance(stated, (int, float, str)):
            return None if stated is None else parse_fps(stated)
        raise ValueError(f"{shown(stated)}, expected a number")
    except ValueError as error:
        raise FormatError(f"fps: {error}", path=path, reason="framerate") from None
