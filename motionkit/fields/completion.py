"""Upsampling, in-betweening and extrapolation of motions with any `MotionEncoder`."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Float64, Int
from motionkit.core.timegrid import SAME_SECONDS, TimeGrid, num_frames_within
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import (
    BatchEncoder,
    MotionEncoder,
    MotionField,
    Observation,
    Poses,
    at_fps,
    check_observed_alike,
    check_skeleton,
    to_motion,
)

SLERP: MotionEncoder = INTERPOLATORS["slerp"]
_TOLERANCE_FRAMES = 1e-6


def upsample(motion: Motion, fps: Fraction, encoder: MotionEncoder = SLERP) -> Motion:
    """The motion at a higher framerate; source frames that fall on the new grid are kept.

    Raises `ValueError` if `fps` is below the motion's.
    """
    if fps < motion.fps:
        raise ValueError(f"{fps} fps is less than the motion's {motion.fps}: use downsample, which filters first")
    if fps == motion.fps:
        return motion
    return complete(motion, encoder, fps=fps).logged(f"upsample {motion.fps} -> {fps} fps ({encoder.name})")


def inbetween(motion: Motion, observed: Bool[np.ndarray, "frames"], encoder: MotionEncoder = SLERP) -> Motion:
    """Predicts the frames that are not `observed` from those that are, which are kept.

    Raises `ValueError` if no frame is observed.
    """
    done = complete(motion, encoder, observed=observed)
    return done.logged(f"in-between {int((~observed).sum())} of {motion.num_frames} frames ({encoder.name})")


def extrapolate(
    motion: Motion, *, before_seconds: float = 0.0, after_seconds: float = 0.0, encoder: MotionEncoder = SLERP
) -> Motion:
    """The motion extended by whole frames before and after, up to the given seconds; its own frames are kept.

    The encoder predicts the extension: `hold` stands still (the zero-velocity row of tables), other interpolators
    continue at constant velocity (`motionkit.fields.interpolation`). Raises `ValueError` for negative seconds.
    """
    done = complete(motion, encoder, before_seconds=before_seconds, after_seconds=after_seconds)
    return done.logged(f"extrapolate {before_seconds:g} s before, {after_seconds:g} s after ({encoder.name})")


def reconstruct(motion: Motion, encoder: MotionEncoder, fps: Fraction | None = None) -> Motion:
    """An encoder's reconstruction of a whole motion, at its framerate or another; observed frames aren't restored."""
    made = to_motion(encoder.encode(Observation.of(motion)), motion.fps if fps is None else fps)
    return made.annotated_like(motion).logged(f"reconstruct ({encoder.name})")


def complete(
    motion: Motion,
    encoder: MotionEncoder,
    *,
    fps: Fraction | None = None,
    observed: Bool[np.ndarray, "frames"] | None = None,
    before_seconds: float = 0.0,
    after_seconds: float = 0.0,
) -> Motion:
    """A motion at any framerate from its observed frames, optionally extended at both ends: the general form.

    Observed frames that fall on the new grid are the given ones to the last bit (quaternions up to their sign, which
    follows their neighbours). An encoder that misses them leaves a jump there; `motionkit.fields.anchoring` removes
    it. The grid starts at the motion's first frame. Raises `ValueError` for negative seconds or if no frame is
    observed.
    """
    known = np.arange(motion.num_frames) if observed is None else np.flatnonzero(observed)
    completion = begin_observed(
        *(Observation.of(motion, observed), known, motion.timegrid, encoder, motion.fps if fps is None else fps),
        before_seconds=before_seconds,
        after_seconds=after_seconds,
    )
    return completion.motion(0, completion.grid.num_frames).annotated_like(motion)


@dataclass(frozen=True, eq=False)
class Completion:
    """An encoded motion that can be sampled whole or in pieces: memory is bounded by the piece.

    `known_frames` are the frame numbers of the observed poses. Frame `given_rows[i]` of `grid` is the observed pose
    `given_poses[i]`; all ascend. `line` overrides the entry in the operation log.
    """

    observation: Observation
    known_frames: Int[np.ndarray, "known"]
    field: MotionField
    grid: TimeGrid
    given_rows: Int[np.ndarray, "given"]
    given_poses: Int[np.ndarray, "given"]
    line: str = ""

    def given(self, start: int, stop: int) -> tuple[Int[np.ndarray, "given"], Int[np.ndarray, "given"]]:
        """Observed frames in [start, stop) of the grid, counted from `start`, and the indices of their poses."""
        here = slice(*np.searchsorted(self.given_rows, (start, stop)).tolist())
        return self.given_rows[here] - start, self.given_poses[here]

    def seconds(self, start: int, stop: int) -> Float64[np.ndarray, "frames"]:
        """Times of frames [start, stop) of the grid."""
        rows = np.arange(start, stop, dtype=np.float64)
        return np.asarray(self.grid.start_seconds + rows * self.grid.fps.denominator / self.grid.fps.numerator)

    def motion(self, start: int, stop: int) -> Motion:
        """Frames [start, stop) of the completed motion, with their own times; raises `ValueError` if out of range."""
        if not 0 <= start < stop <= self.grid.num_frames:
            raise ValueError(f"frames [{start}, {stop}) do not lie inside the completed {self.grid.num_frames}")
        times = self.seconds(start, stop)
        poses = self.field.query(np.clip(times, self.field.start_seconds, self.field.end_seconds))
        rows, given = self.given(start, stop)
        if len(rows):
            poses = _with_given(poses, rows, self.observation.rows(given).poses)
        return poses.at(TimeGrid(self.grid.fps, stop - start, float(times[0])), self.observation.skeleton)


def begin_observed(
    observation: Observation,
    known_frames: Int[np.ndarray, "known"],
    source: TimeGrid,
    encoder: MotionEncoder,
    fps: Fraction,
    *,
    before_seconds: float = 0.0,
    after_seconds: float = 0.0,
) -> Completion:
    """Like `complete`, but not sampled yet, for motions that are written in pieces; raises what `complete` raises.

    Observed are the frames `known_frames` of the grid `source`.
    """
    grid = _grid(source.start_seconds, source.span_seconds, fps, before_seconds, after_seconds)
    rows, frames = _shared_frames(source, grid, before_seconds)
    poses = np.minimum(np.searchsorted(known_frames, frames), len(known_frames) - 1)
    known = known_frames[poses] == frames
    return _completion(observation, known_frames, encoder, grid, rows[known], poses[known])


def begin_uneven(
    observation: Observation,
    known_frames: Int[np.ndarray, "known"],
    span: tuple[float, float],
    encoder: MotionEncoder,
    fps: Fraction,
    *,
    before_seconds: float = 0.0,
    after_seconds: float = 0.0,
) -> Completion:
    """`begin_observed` for unevenly spaced frames; `span` is the times of the first and the last of them.

    The new grid starts at the first frame. A given frame is on it if within a microsecond.
    """
    grid = _grid(span[0], span[1] - span[0], fps, before_seconds, after_seconds)
    seconds = observation.times_seconds
    rows = np.rint((seconds - grid.start_seconds) * float(fps)).astype(np.int64)
    rows = np.clip(rows, 0, grid.num_frames - 1)
    near = np.flatnonzero(np.abs(grid.seconds()[rows] - seconds) < SAME_SECONDS)
    return _completion(observation, known_frames, encoder, grid, rows[near], near)


def _completion(
    observation: Observation,
    known: Int[np.ndarray, "known"],
    encoder: MotionEncoder,
    grid: TimeGrid,
    rows: Int[np.ndarray, "given"],
    poses: Int[np.ndarray, "given"],
) -> Completion:
    last_second = grid.start_seconds + grid.span_seconds
    field = encoder.encode(
        observation,
        before_seconds=max(0.0, observation.start_seconds - grid.start_seconds),
        after_seconds=max(0.0, last_second - observation.end_seconds),
    )
    return Completion(observation, known, at_fps(field, grid.fps), grid, rows, poses)


def query_many(
    encoder: MotionEncoder,
    observations: Sequence[Observation],
    times_seconds: Float64[np.ndarray, "times"],
    fps: Fraction,
) -> list[Poses]:
    """Evaluates the fields of many motions, observed at the same times: batched if the encoder can.

    Times may lie beyond the observed span; fields that depend on the framerate get `fps`. Raises `ValueError` for
    motions that are observed at different times or differ in their joints, and where the encoder cannot go that far.
    """
    check_observed_alike(observations)
    if isinstance(encoder, BatchEncoder):
        return encoder.query_many(observations, times_seconds)
    before = max(0.0, observations[0].start_seconds - float(times_seconds.min()))
    after = max(0.0, float(times_seconds.max()) - observations[0].end_seconds)
    fields = (encoder.encode(observation, before_seconds=before, after_seconds=after) for observation in observations)
    return [at_fps(field, fps).query(times_seconds) for field in fields]


def observed_errors(field: MotionField, observation: Observation) -> Float64[np.ndarray, "frames joints"]:
    """Distances of a field's joints from the observed ones at the observed times, metres.

    Raises `ValueError` for observed times outside the field's domain and for another skeleton.
    """
    check_skeleton(field, observation)
    made = field.query(observation.times_seconds).joint_positions.astype(np.float64)
    return np.asarray(np.linalg.norm(made - observation.poses.joint_positions, axis=-1))


def _grid(
    start_seconds: float, span_seconds: float, fps: Fraction, before_seconds: float, after_seconds: float
) -> TimeGrid:
    if not (0 <= before_seconds < np.inf and 0 <= after_seconds < np.inf):
        raise ValueError(f"seconds to extend by must be 0 or more, not {before_seconds:g} and {after_seconds:g}")
    before = int(np.floor(before_seconds * float(fps) + _TOLERANCE_FRAMES))
    after = num_frames_within(span_seconds + after_seconds, fps)
    return TimeGrid(fps, before + after, start_seconds - float(before / fps))


def _shared_frames(
    source: TimeGrid, grid: TimeGrid, before_seconds: float
) -> tuple[Int[np.ndarray, "shared"], Int[np.ndarray, "shared"]]:
    """Frames of the new grid that coincide with source frames, and which; exact, as framerates are fractions."""
    before = int(np.floor(before_seconds * float(grid.fps) + _TOLERANCE_FRAMES))
    ratio = source.fps / grid.fps
    # Frame k·numerator of the source is frame before + k·denominator of the grid, and no others are the same.
    count = min((source.num_frames - 1) // ratio.numerator, (grid.num_frames - 1 - before) // ratio.denominator) + 1
    shared = np.arange(count)
    return before + shared * ratio.denominator, shared * ratio.numerator


def _with_given(poses: Poses, rows: Int[np.ndarray, "given"], given: Poses) -> Poses:
    positions, rotations, translation = (
        None if made is None else made.copy()
        for made in (poses.joint_positions, poses.local_rotations, poses.root_translation)
    )
    assert positions is not None
    positions[rows] = given.joint_positions
    if rotations is not None and given.local_rotations is not None:
        opposite = np.sum(rotations[rows] * given.local_rotations, axis=-1, keepdims=True) < 0
        rotations[rows] = np.where(opposite, -given.local_rotations, given.local_rotations)
    if translation is not None and given.root_translation is not None:
        translation[rows] = given.root_translation
    return Poses(positions, rotations, translation)
