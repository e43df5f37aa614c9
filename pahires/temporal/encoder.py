"""A trained network as a motion encoder: observations of any length, at even or uneven times, to motion fields.

Long observations are cut into overlapping windows of as many frames as in training; each is evaluated in its own frame,
and outputs are cross-faded in the middle of overlaps, so a pose depends on the observation and its time alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch

from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.features.rotations import PoseRows, num_features, poses_of, rows_of_poses
from motionkit.fields.motion_field import (
    Observation,
    Poses,
    check_observed_alike,
    check_times,
    continuous_rotations,
    query_in_blocks,
    with_rotations,
)
from pahires.temporal.base_curves import WindowFrames
from pahires.temporal.network import ObservedWindow
from pahires.temporal.training import TrainedNetwork

# Beyond the trained extrapolation range: raise, hold the furthest instant's pose, or extrapolate anyway.
Extrapolation = Literal["error", "clamp", "allow"]

OVERLAP_FRAMES = 8
WINDOWS_AT_ONCE = 32
MOTIONS_AT_ONCE = 64
QUERIES_AT_ONCE = 256


@dataclass(frozen=True, eq=False)
class NetworkEncoder:
    """A `motionkit.fields.motion_field.MotionEncoder`, and `BatchEncoder`, over a trained network.

    Observations must have the joints that the network was trained on: the 22-joint layout, or with `layout=native` the
    corpus's own. Poses without rotations get those of inverse kinematics; the field then has none either.
    """

    trained: TrainedNetwork
    window_frames: int = 32
    extrapolation: Extrapolation = "clamp"

    @property
    def name(self) -> str:
        """Name for tables and operation logs."""
        return self.trained.name

    @property
    def longest_gap_seconds(self) -> float:
        """The longest time between neighbouring observed frames in training."""
        return self.trained.longest_gap_seconds

    @property
    def reach_seconds(self) -> float:
        """The longest extrapolation in training."""
        return self.trained.reach_seconds

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> "NetworkField":
        """The field of an observation.

        Raises `ValueError` for other joints, a negative reach, and with `extrapolation="error"` a longer one than in
        training.
        """
        if observation.skeleton.joint_names != self.trained.skeleton.joint_names:
            raise ValueError(
                f"{self.name} knows the {self.trained.skeleton.num_joints} joints of "
                f"{self.trained.skeleton.name!r}, not those of {observation.skeleton!r}: map the motion first "
                "(motionkit.core.skeletons.mapping.map_joints)"
            )
        if not (0 <= before_seconds < np.inf and 0 <= after_seconds < np.inf):
            raise ValueError(f"seconds beyond a motion must be 0 or more, not {before_seconds:g} and {after_seconds:g}")
        reach = self.trained.reach_seconds
        if self.extrapolation == "error" and max(before_seconds, after_seconds) > reach + 1e-6:
            raise ValueError(
                f"{self.name} was trained up to {reach:.2f} s beyond what is observed, not "
                f"{max(before_seconds, after_seconds):.2f} s: ask for less, or let it stand still there "
                "(extrapolation='clamp')"
            )
        observation = continuous_rotations(observation)
        return NetworkField(
            self,
            observation,
            _window_starts(len(observation), self.window_frames),
            observation.start_seconds - before_seconds,
            observation.end_seconds + after_seconds,
        )

    def query_many(
        self, observations: Sequence[Observation], times_seconds: Float64[np.ndarray, "times"]
    ) -> list[Poses]:
        """Poses of many motions at the same times, with the windows of all of them in one batch.

        See `motionkit.fields.motion_field.BatchEncoder`; raises what `encode` does. Motions longer than a window are
        evaluated one by one.
        """
        check_observed_alike(observations)
        first = observations[0]
        reach = (
            max(0.0, first.start_seconds - float(times_seconds.min())),
            max(0.0, float(times_seconds.max()) - first.end_seconds),
        )
        fields = [
            self.encode(observation, before_seconds=reach[0], after_seconds=reach[1]) for observation in observations
        ]
        if len(first) > self.window_frames:
            return [field.query(times_seconds) for field in fields]
        times = fields[0].within_reach(times_seconds)
        poses: list[Poses] = []
        for start in range(0, len(fields), MOTIONS_AT_ONCE):
            some = fields[start : start + MOTIONS_AT_ONCE]
            rows = np.stack([field.rows.vectors for field in some])
            vectors = self.vectors(rows, np.tile(first.times_seconds, (len(some), 1)), np.tile(times, (len(some), 1)))
            poses += [field.poses_of(times_seconds, answer) for field, answer in zip(some, vectors, strict=True)]
        return poses

    @torch.no_grad()
    def vectors(
        self,
        rows: Float32[np.ndarray, "batch frames numbers"],
        observed_seconds: Float64[np.ndarray, "batch frames"],
        query_seconds: Float64[np.ndarray, "batch queries"],
    ) -> Float32[np.ndarray, "batch queries numbers"]:
        """World rows at instants of windows, each evaluated in its own frame."""
        trained = self.trained
        placed = WindowFrames.of(rows, trained.skeleton)
        scaling = trained.predictor.scaling
        device = scaling.mean.device
        start = observed_seconds[:, :1]
        window = ObservedWindow(
            frames=scaling.apply(torch.from_numpy(placed.to_window(rows)).to(device)),
            times_seconds=torch.from_numpy((observed_seconds - start).astype(np.float32)).to(device),
            queries_seconds=torch.from_numpy((query_seconds - start).astype(np.float32)).to(device),
            query_spacing_seconds=torch.full((len(rows),), trained.spacing_seconds, device=device),
        )
        return placed.to_world(scaling.invert(trained.predictor.smooth(window)).cpu().numpy())


@dataclass(frozen=True, eq=False)
class NetworkField:
    """A `MotionField`: an observation, and the network that completes it."""

    encoder: NetworkEncoder
    observation: Observation
    window_starts: Int64[np.ndarray, "windows"]
    start_seconds: float
    end_seconds: float

    @property
    def skeleton(self) -> Skeleton:
        """The observation's skeleton."""
        return self.observation.skeleton

    @cached_property
    def rows(self) -> PoseRows:
        """The rotation rows of the observed poses."""
        observed = self.observation
        # In the 22-joint layout rotations are computed from that layout's own rest pose, for a common convention.
        if observed.poses.local_rotations is None and observed.skeleton.joint_names == SMPL22.joint_names:
            observed = replace(observed, skeleton=SMPL22)
        turned = with_rotations(observed)
        return rows_of_poses(turned.poses, turned.skeleton)

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        check_times(self, times_seconds)
        return query_in_blocks(lambda times: self.poses_of(times, self.vectors(times)), times_seconds)

    def vectors(self, times_seconds: Float64[np.ndarray, "times"]) -> Float32[np.ndarray, "times numbers"]:
        """World rotation rows at any times, as the network outputs them (columns not yet orthonormal)."""
        times_seconds = self.within_reach(times_seconds)
        window, fade = self._windows_of(times_seconds)
        fading = np.flatnonzero(fade > 0)
        rows = self._in_windows(
            np.concatenate((window, window[fading] + 1)), np.concatenate((times_seconds, times_seconds[fading]))
        )
        vectors, following = rows[: len(window)], rows[len(window) :]
        weight = fade[fading, None].astype(np.float32)
        vectors[fading] += weight * (following - vectors[fading])
        return vectors

    def within_reach(self, times_seconds: Float64[np.ndarray, "times"]) -> Float64[np.ndarray, "times"]:
        """The times to evaluate the network at, clamped to the trained extrapolation range if configured."""
        if self.encoder.extrapolation != "clamp":
            return times_seconds
        reach = self.encoder.trained.reach_seconds
        lowest, highest = self.observation.start_seconds - reach, self.observation.end_seconds + reach
        return np.asarray(np.clip(times_seconds, lowest, highest))

    def _windows_of(
        self, times: Float64[np.ndarray, "times"]
    ) -> tuple[Int64[np.ndarray, "times"], Float64[np.ndarray, "times"]]:
        """The window of each time, and the weight of the next one: 0 outside the middle of the overlaps."""
        if len(self.window_starts) == 1:
            return np.zeros(len(times), np.int64), np.zeros(len(times))
        observed = self.observation.times_seconds
        first, last = self.window_starts[1:], self.window_starts[:-1] + self.encoder.window_frames - 1
        middle = (first + last) // 2
        begins, ends = observed[middle], observed[middle + 1]
        window = np.searchsorted(ends, times, side="right")
        u = (times - np.append(begins, np.inf)[window]) / np.append(ends - begins, 1.0)[window]
        u = np.clip(u, 0.0, 1.0)
        return window.astype(np.int64), u**3 * (u * (6.0 * u - 15.0) + 10.0)

    def _in_windows(
        self, window: Int64[np.ndarray, "queries"], times: Float64[np.ndarray, "queries"]
    ) -> Float32[np.ndarray, "queries numbers"]:
        """Rows at times, each in its given window; windows are batched, with bounded memory."""
        order = np.lexsort((times, window))
        window, times = window[order], times[order]
        result = np.empty((len(times), num_features(self.skeleton.num_joints)), np.float32)
        # Runs of queries of one window, at most QUERIES_AT_ONCE; many runs are padded to a batch.
        first_of_window = np.searchsorted(window, window)
        place = np.arange(len(window)) - first_of_window
        run_starts = np.flatnonzero(place % QUERIES_AT_ONCE == 0)
        run_ends = np.append(run_starts[1:], len(window))
        for first in range(0, len(run_starts), WINDOWS_AT_ONCE):
            starts, ends = run_starts[first : first + WINDOWS_AT_ONCE], run_ends[first : first + WINDOWS_AT_ONCE]
            columns = np.arange(int((ends - starts).max()))
            index = np.minimum(starts[:, None] + columns, ends[:, None] - 1)
            real = starts[:, None] + columns < ends[:, None]
            result[order[index[real]]] = self._vectors_of(window[starts], times[index])[real]
        return result

    def _vectors_of(
        self, windows: Int64[np.ndarray, "batch"], times: Float64[np.ndarray, "batch queries"]
    ) -> Float32[np.ndarray, "batch queries numbers"]:
        count = min(len(self.observation), self.encoder.window_frames)
        frames = self.window_starts[windows][:, None] + np.arange(count)
        return self.encoder.vectors(self.rows.vectors[frames], self.observation.times_seconds[frames], times)

    def poses_of(self, times: Float64[np.ndarray, "times"], vectors: Float32[np.ndarray, "times numbers"]) -> Poses:
        """World rows at these times as poses of the observed body."""
        before, weight = self._between(times)
        after = np.minimum(before + 1, len(self.observation) - 1)
        rows, given = self.rows, self.observation.poses
        bones = rows.bones[before]
        bones = bones + weight[:, None, None] * (rows.bones[after] - bones)
        poses = poses_of(vectors, bones, rows.skeleton)
        if given.local_rotations is None or poses.local_rotations is None:
            return Poses(poses.joint_positions)
        near = given.local_rotations[before]
        opposite = np.sum(near * poses.local_rotations, axis=-1, keepdims=True) < 0
        rotations = np.where(opposite, -poses.local_rotations, poses.local_rotations)
        translation = None
        if given.root_translation is not None:
            rest = given.joint_positions[before, 0] - given.root_translation[before]
            translation = poses.joint_positions[:, 0] - rest
        return Poses(poses.joint_positions, rotations, translation)

    def _between(
        self, times: Float64[np.ndarray, "times"]
    ) -> tuple[Int64[np.ndarray, "times"], Float32[np.ndarray, "times"]]:
        """The observed frame before each time, and the fraction of the way to the next one."""
        observed = self.observation.times_seconds
        before = np.clip(np.searchsorted(observed, times, side="right") - 1, 0, max(0, len(observed) - 2))
        if len(observed) == 1:
            return before, np.zeros(len(times), np.float32)
        fraction = (times - observed[before]) / (observed[before + 1] - observed[before])
        return before, np.clip(fraction, 0.0, 1.0).astype(np.float32)


def _window_starts(num_frames: int, window_frames: int) -> Int64[np.ndarray, "windows"]:
    """First frames of the fewest windows that cover all frames and overlap by at least `OVERLAP_FRAMES`."""
    if num_frames <= window_frames:
        return np.zeros(1, np.int64)
    count = -(-(num_frames - OVERLAP_FRAMES) // (window_frames - OVERLAP_FRAMES))
    return np.floor(np.linspace(0, num_frames - window_frames, max(2, count))).astype(np.int64)
