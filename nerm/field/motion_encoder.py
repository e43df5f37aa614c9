"""NeRM as a motion encoder: observed motion of any length as latents found by optimisation (Table 4, B.3).

Overlapping windows of l_max cover the motion, each with its own frame and its own z, fitted to the frames observed in
it; decoded windows are cross-faded. Long captures, gaps and uneven times need no special treatment.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from motionkit.core.shapes import Float32, Float64, Int, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import normalise_seconds
from motionkit.data.corpus import FrameValues, open_frames
from motionkit.data.poses import WindowPoses
from motionkit.data.reconstruction import ModelWindows
from motionkit.data.windows import Windows, cut_windows
from motionkit.features import field
from motionkit.fields.assembly import AssembledField, Piece, assemble, even_starts
from motionkit.fields.motion_field import MotionField, Observation
from motionkit.store.reader import Store
from motionkit.training.pose_vectors import PoseTensors
from motionkit.training.run import RunFolder
from nerm.field.encoding import encode_by_optimisation
from nerm.field.trained import TrainedField, load_field
from nerm.names import row_name

POSES_TO_ENCODE_FROM = 100
WINDOWS_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class NermEncoder:
    """A `MotionEncoder` that `ReconstructsWindows`: latents of a frozen field, one per window of at most l_max seconds.

    Neighbouring windows overlap by at least `overlap_seconds`; each z is fitted to at most `num_poses` observed poses,
    evenly spaced among those of its window. `name` is its row in tables.
    """

    trained: TrainedField
    name: str = "NeRM"
    overlap_seconds: float = 1.0
    num_poses: int = POSES_TO_ENCODE_FROM

    @property
    def store_fingerprint(self) -> str:
        """Fingerprint of the store that the field was trained on."""
        return self.trained.store_fingerprint

    def training_windows(self, store: Store) -> ModelWindows:
        """The training windows, decoded from their posterior means."""
        trained = self.trained
        source, _ = open_frames(trained.vectors, store, trained.config.where or None)

        def fields(rows: Int64[np.ndarray, "chosen"]) -> list[MotionField]:
            return self._fields(trained.windows.select(rows), trained.posterior_mean[torch.from_numpy(rows)])

        return ModelWindows(source, trained.windows, fields, "from their μ")

    def other_windows(self, store: Store, where: str | None) -> ModelWindows:
        """Windows of the sequences that match `where`, each z found by optimisation against the frozen field.

        Raises `UsageError` if there are none.
        """
        trained = self.trained
        source, frames = open_frames(trained.vectors, store, where)
        windows = cut_windows(
            source,
            max_duration_seconds=trained.max_duration_seconds,
            min_duration_seconds=trained.config.windows.min_duration_seconds,
        )

        def fields(rows: Int64[np.ndarray, "chosen"]) -> list[MotionField]:
            chosen = windows.select(rows)
            return self._fields(chosen, encode_windows(trained, chosen, frames))

        return ModelWindows(source, windows, fields, "encoded by optimisation")

    def _fields(self, windows: Windows, latents: Float32[torch.Tensor, "windows latent"]) -> list[MotionField]:
        seconds = windows.duration_seconds.tolist()
        return [
            self.trained.as_motion_field(each, float(length)) for each, length in zip(latents, seconds, strict=True)
        ]

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> AssembledField:
        """The motion as a field in the world's frame.

        Raises `ValueError` for a skeleton other than the 22-joint layout, and if a window has no observed pose (a gap,
        or extrapolation, about as long as l_max).
        """
        # By name: LaFAN1's skeleton has 22 joints too, but different ones.
        if observation.skeleton.joint_names != SMPL22.joint_names:
            raise ValueError(
                f"NeRM knows the {SMPL22.num_joints} joints of {SMPL22.name!r}, not those of "
                f"{observation.skeleton!r}: map the motion first (motionkit.core.skeletons.mapping.map_joints)"
            )
        start = observation.start_seconds - before_seconds
        span = observation.end_seconds + after_seconds - start
        length = min(span, self.trained.max_duration_seconds)
        starts = start + even_starts(span, self.trained.max_duration_seconds, self.overlap_seconds)
        pieces: list[Piece] = []
        for first in range(0, len(starts), WINDOWS_AT_ONCE):
            pieces += self._pieces(observation, starts[first : first + WINDOWS_AT_ONCE], length)
        return assemble(pieces)

    def _pieces(self, observation: Observation, starts: Float64[np.ndarray, "windows"], length: float) -> list[Piece]:
        rows = self._rows(observation, starts, length)
        positions = observation.poses.joint_positions[rows]
        yaw, origin = field.window_frame(positions[:, 0])
        seconds = observation.times_seconds[rows] - starts[:, None]
        fps = 1.0 / np.median(np.diff(observation.times_seconds)) if len(observation) > 1 else 30.0
        batch = PoseTensors(
            window=torch.arange(len(starts)),
            coordinates=torch.from_numpy(normalise_seconds(seconds, self.trained.max_duration_seconds)),
            fps=torch.full((len(starts),), float(fps), dtype=torch.float64),
            vectors=torch.from_numpy(field.encode(positions, yaw, origin)),
        )
        latents = encode_by_optimisation(self.trained, batch)
        return [
            Piece(
                self.trained.as_motion_field(latents[number], length),
                float(starts[number]),
                float(yaw[number]),
                (float(origin[number, 0]), float(origin[number, 1])),
            )
            for number in range(len(starts))
        ]

    def _rows(
        self, observation: Observation, starts: Float64[np.ndarray, "windows"], length: float
    ) -> Int[np.ndarray, "windows poses"]:
        """Observed frames to fit each window to; repeated if it has fewer than `num_poses`."""
        times = observation.times_seconds
        first = np.searchsorted(times, starts - 1e-9)
        last = np.searchsorted(times, starts + length + 1e-9) - 1
        if (last < first).any():
            empty = float(starts[np.argmax(last < first)])
            raise ValueError(
                f"no pose is observed between {empty:.2f} and {empty + length:.2f} s: a window of "
                f"{self.trained.max_duration_seconds:g} s (l_max) needs at least one"
            )
        return np.rint(np.linspace(first, last, self.num_poses, axis=1)).astype(np.int64)


def encode_windows(
    trained: TrainedField,
    windows: Windows,
    frames: FrameValues,
    *,
    num_poses: int = POSES_TO_ENCODE_FROM,
) -> Float32[torch.Tensor, "windows latent"]:
    """The latents of windows that were not in training, by optimisation on `num_poses` native poses of each.

    `frames` come from opening the field's pose vectors.
    """
    poses = WindowPoses(windows, frames)
    parts = [
        encode_by_optimisation(
            trained,
            PoseTensors.of(poses.evenly(np.arange(start, min(start + WINDOWS_AT_ONCE, len(windows))), num_poses)),
        )
        for start in range(0, len(windows), WINDOWS_AT_ONCE)
    ]
    return torch.cat(parts)


def load(run: Path) -> NermEncoder:
    """The encoder of a run whose stage `field` is trained.

    Raises what `load_field` raises.
    """
    trained = load_field(run)
    return NermEncoder(trained, row_name(RunFolder(run), trained.config))
