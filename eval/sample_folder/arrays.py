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
    "vectors, or a batch of these"
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

    @property
    def is_vectors(self) -> bool:
        """Whether these are pose vectors, not joints."""
        return self.numbers.ndim == 2


def read_stored(path: Path) -> list[StoredMotion]:
    """All motions of a .npy or .npz file. Raises `FormatError` for files without any; NaN is not checked."""
    if path.suffix.lower() == ".npz":
        return _of_dictionary(_archive(path), path)
    found = npy.read_object(path, source_file.read_bytes(path))
    if isinstance(found, dict):
        return _of_dictionary(found, path)
    if not isinstance(found, np.ndarray) or found.dtype.kind not in npy.NUMBERS:
        message = "expected an array of numbers, or a dictionary of named arrays"
        raise FormatError(message, path=path, reason="not-a-number")
    motions = split_motions(found, path)
    return [StoredMotion(numbers, _index(index, motions)) for index, numbers in enumerate(motions)]


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


def _archive(path: Path) -> dict[str, Any]:
    """The known members of an .npz file: arrays unchanged, texts as lists."""
    archive = npy.open_archive(path, source_file.read_bytes(path))
    found: dict[str, Any] = {}
    for key in archive.keys:
        if key in (*TEXT_KEYS, *ACTION_KEYS):
            found[key] = list(archive.strings(key))
        elif key in (*MOTION_KEYS, "lengths"):
            found[key] = archive.array(key)
        elif key in ("num_samples", "num_repetitions", "fps"):
            found[key] = archive.scalar(key)
    return found


def _of_dictionary(found: Mapping[str, Any], path: Path) -> list[StoredMotion]:
    """Motions of a dictionary such as MDM's: a batch under `motion`, with lengths, texts and repetitions beside it.

    Repetitions follow one another: motion r · num_samples + s is repetition r of prompt s (motion-diffusion-model,
    sample/generate.py). Frames beyond a motion's length are padding.
    """
    array = next((found[key] for key in MOTION_KEYS if isinstance(found.get(key), np.ndarray)), None)
    if array is None:
        held = ", ".join(sorted(map(str, found)))[:200] or "no known key"
        raise FormatError(
            f"no array 'motion'; it holds {held} (docs/samples.md says how to export)", path=path, reason="missing-key"
        )
    if array.dtype.kind not in "fiu":
        raise FormatError(f"array of {array.dtype}, expected numbers", path=path, reason="not-a-number")
    motions = split_motions(array, path)
    lengths = _lengths(found.get("lengths"), motions, path)
    captions = _texts(found, TEXT_KEYS, len(motions), path)
    actions = _texts(found, ACTION_KEYS, len(motions), path)
    groups = _groups(found, len(motions), path)
    fps = _fps(found.get("fps"), path)
    return [
        StoredMotion(numbers[:length], _index(index, motions), caption, action, group, fps)
        for index, (numbers, length, caption, action, group) in enumerate(
            zip(motions, lengths, captions, actions, groups, strict=True)
        )
    ]


def _index(index: int, motions: Sequence[np.ndarray]) -> int | None:
    return index if len(motions) > 1 else None


def _lengths(stated: object, motions: Sequence[np.ndarray], path: Path) -> list[int]:
    if stated is None:
        return [len(numbers) for numbers in motions]
    lengths = stated.ravel().tolist() if isinstance(stated, np.ndarray) else stated
    frames = len(motions[0])
    if (
        not isinstance(lengths, (list, tuple))
        or len(lengths) != len(motions)
        or not all(isinstance(length, int) and 1 <= length <= frames for length in lengths)
    ):
        raise FormatError(
            f"lengths {shown(lengths)}, expected {len(motions)} whole numbers from 1 to {frames}",
            path=path,
            reason="lengths",
        )
    return list(lengths)


def _texts(found: Mapping[str, Any], keys: Sequence[str], count: int, path: Path) -> list[str]:
    values = next((found[key] for key in keys if found.get(key) is not None), None)
    if values is None:
        return [""] * count
    listed = values.tolist() if isinstance(values, np.ndarray) else [values] if isinstance(values, str) else values
    if not isinstance(listed, (list, tuple)) or not all(isinstance(value, (str, int, float)) for value in listed):
        raise FormatError(f"{' or '.join(keys)} is no list of texts", path=path, reason="text")
    texts = [value if isinstance(value, str) else shown(value) for value in listed]
    if len(texts) != count:
        raise FormatError(f"{len(texts)} texts for {count} motions", path=path, reason="channel-count")
    return texts


def _groups(found: Mapping[str, Any], count: int, path: Path) -> list[str]:
    samples, repetitions = found.get("num_samples"), found.get("num_repetitions")
    if samples is None or repetitions is None:
        return [""] * count
    whole = isinstance(samples, int) and isinstance(repetitions, int)
    if not whole or samples < 1 or samples * repetitions != count:
        message = f"{shown(samples)} samples × {shown(repetitions)} repetitions for {count} motions"
        raise FormatError(message, path=path, reason="channel-count")
    return [str(index % samples) for index in range(count)]


def _fps(stated: object, path: Path) -> Fraction | None:
    if stated is None:
        return None
    try:
        if not isinstance(stated, (int, float, str)):
            raise ValueError("no number")
        return parse_fps(stated)
    except ValueError as error:
        raise FormatError(f"fps: {error}", path=path, reason="framerate") from None
