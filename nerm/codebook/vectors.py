"""Pose vectors for training the codebook, and the file that holds them during training.

For J joints 6·J + 1 numbers, 133 for 22: yaw rate (rad/s), root velocity to the body's left and front (m/s), root
height (m), joints 1 … J − 1 relative to the root's ground point and facing Z+ (m, HumanML3D's "RIC" block), velocities
of all joints in the same axes (m/s). The published vector's rotations and contacts are left out: both are functions of
positions (swing-only inverse kinematics, a threshold on speed).
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import torch

from motionkit.core.errors import DamagedFileError, UsageError
from motionkit.core.files import read_json, sha256_of, whole_file, write_json
from motionkit.core.progress import warn
from motionkit.core.shapes import Float, Float32, Int64
from motionkit.data.windows import PositionSource
from motionkit.features import field
from motionkit.fields.resample import resample_positions
from nerm.settings import CodebookConfig


def joint_positions_block(num_joints: int) -> slice:
    """The slice of joint positions in a vector (the RIC block)."""
    return slice(4, 4 + 3 * (num_joints - 1))


def codebook_vectors(
    joint_positions: Float[np.ndarray, "frames joints 3"], fps: Fraction
) -> Float32[np.ndarray, "rows numbers"]:
    """T − 1 vectors of T poses in metres; raises `ValueError` for fewer than two poses."""
    if len(joint_positions) < 2:
        raise ValueError("pose vectors need two poses or more")
    # Float32 rounds yaw to 1e-7 rad, its rate to 1e-5 rad/s at 120 fps, and differently on each processor.
    joint_positions = joint_positions.astype(np.float64)
    yaw = np.unwrap(field.heading(joint_positions))
    rate = float(fps)
    here, facing = joint_positions[:-1], yaw[:-1]
    turned = field.to_window(here[:, None], facing, here[:, 0, (0, 2)])[:, 0]
    velocities = (
        field.to_window(np.diff(joint_positions, axis=0)[:, None], facing, np.zeros((len(here), 2)))[:, 0] * rate
    )
    parts = (
        (np.diff(yaw) * rate)[:, None],
        velocities[:, 0, (0, 2)],
        turned[:, 0, 1:2],
        turned[:, 1:].reshape(len(here), -1),
        velocities.reshape(len(here), -1),
    )
    return np.concatenate(parts, axis=1).astype(np.float32)


SMALLEST_SCALE = 1e-3


@dataclass(frozen=True, eq=False)
class VectorCorpus:
    """Pose vectors of all sequences, concatenated, at one framerate, as a memory map.

    `first_rows` are the rows at which a training window may start; `mean` and `scale` standardise each number.
    """

    vectors: Float32[np.ndarray, "rows numbers"]
    first_rows: Int64[np.ndarray, "starts"]
    mean: Float32[torch.Tensor, "numbers"]
    scale: Float32[torch.Tensor, "numbers"]

    def windows(
        self, starts: Int64[torch.Tensor, "batch"], frames: int
    ) -> Float32[torch.Tensor, "batch frames numbers"]:
        """Standardised windows from the n-th possible starts."""
        rows = self.first_rows[starts.numpy()][:, None] + np.arange(frames)
        return (torch.from_numpy(np.asarray(self.vectors[rows])) - self.mean) / self.scale


def prepare_vectors(source: PositionSource, config: CodebookConfig, path: Path) -> None:
    """Resample every sequence to `config.fps` and write its `codebook_vectors` to `path`, with a table beside it.

    Complete files from an interrupted run are kept. Raises `UsageError` as `check_lengths` does.
    """
    check_lengths(source, config)
    table = table_of(path)
    if table.is_file():
        fault = _fault_of(path)
        if fault is None:
            return
        warn(f"{path} is made again: {fault}")
        table.unlink()
    _write_vectors(source, config, path)


def open_vectors(config: CodebookConfig, path: Path) -> VectorCorpus:
    """Open the vectors that `prepare_vectors` wrote and checked."""
    table = _read_table(path)
    frames = config.window_frames
    ends = np.cumsum(table["rows"])
    starts = [np.arange(end - length, end - frames + 1) for end, length in zip(ends, table["rows"], strict=True)]
    first_rows = np.concatenate([*starts, np.zeros(0, dtype=np.int64)]).astype(np.int64)
    vectors = np.memmap(path, dtype="<f4", mode="r", shape=(int(ends[-1]), table["numbers"])).view(np.ndarray)
    mean, scale = _statistics(vectors)
    return VectorCorpus(vectors, first_rows, mean, scale)


def remove_vectors(path: Path) -> None:
    """Delete the vectors and their table; the table first, since vectors without one are written again."""
    for each in (table_of(path), path):
        each.unlink(missing_ok=True)


def table_of(path: Path) -> Path:
    """The table beside a file of vectors: rows per sequence, numbers per row, checksum."""
    return path.with_suffix(".json")


def _fault_of(path: Path) -> str | None:
    """Why the vectors cannot be reused; None if they can."""
    try:
        table = _read_table(path)
    except DamagedFileError as error:
        return f"{error.path.name} is damaged ({error.fault})"
    if "sha256" not in table:
        return f"{table_of(path).name} has no checksum"
    num_bytes = 4 * sum(table["rows"]) * table["numbers"]
    if not path.is_file() or path.stat().st_size != num_bytes or sha256_of(path) != table["sha256"]:
        return "its content does not match its checksum"
    return None


def _read_table(path: Path) -> dict[str, Any]:
    return read_json(table_of(path), "delete it, and it is made again")


def check_lengths(source: PositionSource, config: CodebookConfig) -> None:
    """Raise `UsageError` if no sequence is as long as a training window."""
    frames, fps = config.window_frames, config.fps
    if not (_num_vectors(source, fps) >= frames).any():
        seconds = (source.num_frames - 1) * source.fps_denominator / source.fps_numerator
        raise UsageError(
            f"no sequence has {frames} poses at {fps} fps ({frames / fps:g} s), the codebook's windows; the longest "
            f"lasts {seconds.max():.3g} s: set codebook.window_frames lower"
        )


def _num_vectors(source: PositionSource, fps: int) -> Int64[np.ndarray, "sequences"]:
    """Rows of each sequence when resampled to `fps`."""
    intervals = (source.num_frames.astype(np.int64) - 1) * fps * source.fps_denominator
    return np.asarray(intervals // source.fps_numerator, dtype=np.int64)


def _write_vectors(source: PositionSource, config: CodebookConfig, path: Path) -> None:
    rows, digest = [], hashlib.sha256()
    with whole_file(path) as temporary, temporary.open("wb") as file:
        for vectors in _resampled_vectors(source, config):
            content = np.ascontiguousarray(vectors, dtype="<f4").data.cast("B")
            file.write(content)
            digest.update(content)
            rows.append(len(vectors))
    size = 6 * source.positions.shape[1] + 1
    write_json(table_of(path), {"rows": rows, "numbers": size, "sha256": digest.hexdigest()})


def _resampled_vectors(source: PositionSource, config: CodebookConfig) -> Iterator[Float32[np.ndarray, "rows numbers"]]:
    fps = Fraction(config.fps)
    for index in np.flatnonzero(_num_vectors(source, config.fps) >= config.window_frames).tolist():
        start, count = int(source.start_row[index]), int(source.num_frames[index])
        native_fps = Fraction(int(source.fps_numerator[index]), int(source.fps_denominator[index]))
        positions = resample_positions(np.asarray(source.positions[start : start + count]), native_fps, fps)
        yield codebook_vectors(positions, fps)


def _statistics(
    vectors: Float32[np.ndarray, "rows numbers"],
) -> tuple[Float32[torch.Tensor, "numbers"], Float32[torch.Tensor, "numbers"]]:
    total = np.zeros(vectors.shape[1])
    squares = np.zeros(vectors.shape[1])
    for start in range(0, len(vectors), 16_384):
        block = vectors[start : start + 16_384].astype(np.float64)
        total += block.sum(0)
        squares += np.square(block).sum(0)
    mean = total / len(vectors)
    scale = np.sqrt(np.maximum(squares / len(vectors) - mean**2, SMALLEST_SCALE**2))
    return torch.from_numpy(mean).float(), torch.from_numpy(scale).float()
