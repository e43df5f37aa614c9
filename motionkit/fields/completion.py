"""Upsampling, in-betweening and extrapolation of motions with any `MotionEncoder`: one function, `complete`."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Int
from motionkit.core.timegrid import SAME_SECONDS, TimeGrid, num_frames_within
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import (
    MotionEncoder,
    MotionField,
    Observation,
    Poses,
    at_fps,
)

SLERP: MotionEncoder = INTERPOLATORS["slerp"]
_TOLERANCE_FRAMES = 1e-6


def upsample(motion: Motion, fps: Fraction, encoder: MotionEncoder = SLERP) -> Motion:
    """The motion at a higher framerate; source frames that fall on the new grid are kept.

    Raises `ValueError` if `fps` is below the motion's.
    """
    if fps < motion.fps:
        raise ValueError(f"{fps} fps is less than the motion's {motion.fps}: use resample, which filters first")
    if fps == motion.fps:
        return motion
    return complete(motion, encoder, fps=fps).logged(f"upsample {motion.fps} -> {fps} fps ({encoder.name})")


def complete(
    motion: Motion,
    encoder: MotionEncoder,
    *,
    fps: Fraction | None = None,
    observed: Bool[np.ndarray, "frames"] | None = None,
    before_seconds: float = 0.0,
    after_seconds: float = 0.0,
) -> Motion:
    """A motion at any framerate from its `observed` frames (default: all), optionally extended at both ends.

    Observed frames that fall on the new grid are the given ones to the last bit (quaternions up to their sign, which
    follows their neighbours). An encoder that misses them leaves a jump there; `motionkit.fields.anchoring` removes
    it. The grid starts at the motion's first frame, or by whole frames earlier. Beyond both ends `hold` stands still
    (the zero-velocity row of tables), other interpolators go on at constant velocity. Raises `ValueError` for negative
    seconds or if no frame is observed.
    """
    start = motion.timegrid.start_seconds
    completion = begin_completion(
        Observation.of(motion, observed),
        (start, start + motion.timegrid.span_seconds),
        encoder,
        motion.fps if fps is None else fps,
        before_seconds=before_seconds,
        after_seconds=after_seconds,
    )
    return completion.motion().annotated_like(motion)


@dataclass(frozen=True, eq=False)
class Completion:
    """An encoded motion, to be sampled on `grid`; frame `given_rows[i]` is the observed pose `given_poses[i]`."""

    observation: Observation
    field: MotionField
    grid: TimeGrid
    given_rows: Int[np.ndarray, "given"]
    given_poses: Int[np.ndarray, "given"]

    def motion(self) -> Motion:
        """The completed motion."""
        poses = self.field.query(np.clip(self.grid.seconds(), self.field.start_seconds, self.field.end_seconds))
        if len(self.given_rows):
            poses = _with_given(poses, self.given_rows, self.observation.poses.rows(self.given_poses))
        return poses.at(self.grid, self.observation.skeleton)


def begin_completion(
    observation: Observation,
    span: tuple[float, float],
    encoder: MotionEncoder,
    fps: Fraction,
    *,
    before_seconds: float = 0.0,
    after_seconds: float = 0.0,
) -> Completion:
    """Like `complete`, for frames at even or uneven times, before they are sampled; raises what `complete` raises.

    `span` are the times of the first and the last frame of the motion, observed or not. A given frame is on the new
    grid if it is within a microsecond of one of its frames.
    """
    if not (0 <= before_seconds < np.inf and 0 <= after_seconds < np.inf):
        raise ValueError(f"seconds to extend by must be 0 or more, not {before_seconds:g} and {after_seconds:g}")
    before = int(np.floor(before_seconds * float(fps) + _TOLERANCE_FRAMES))
    after = num_frames_within(span[1] - span[0] + after_seconds, fps)
    grid = TimeGrid(fps, before + after, span[0] - float(before / fps))
    seconds = observation.times_seconds
    rows = np.clip(np.rint((seconds - grid.start_seconds) * float(fps)).astype(np.int64), 0, grid.num_frames - 1)
    given = np.flatnonzero(np.abs(grid.seconds()[rows] - seconds) < SAME_SECONDS)
    field = encoder.encode(
        observation,
        before_seconds=max(0.0, observation.start_seconds - grid.start_seconds),
        after_seconds=max(0.0, grid.start_seconds + grid.span_seconds - observation.end_seconds),
    )
    return Completion(observation, at_fps(field, fps), grid, rows[given], given)


def _with_given(poses: Poses, rows: Int[np.ndarray, "given"], given: Poses) -> Poses:
    completed = poses.copy()
    completed.joint_positions[rows] = given.joint_positions
    if completed.local_rotations is not None and given.local_rotations is not None:
        opposite = np.sum(completed.local_rotations[rows] * given.local_rotations, axis=-1, keepdims=True) < 0
        completed.local_rotations[rows] = np.where(opposite, -given.local_rotations, given.local_rotations)
    if completed.root_translation is not None and given.root_translation is not None:
        completed.root_translation[rows] = given.root_translation
    return completed
