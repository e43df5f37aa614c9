"""A motion at other times: completed (upsampled, in-betweened, extrapolated) by any `MotionEncoder`, or resampled.

Upwards, a motion becomes a motion field (`upsample`); downwards, everything above the new
Nyquist frequency is filtered out first. `resample_positions` is the band-limited function on bare arrays that
evaluators use both ways.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from motionkit.core.kinematics import continuous_quaternions
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float64, Int, Int64
from motionkit.core.timegrid import SAME_SECONDS, Framerate, TimeGrid, num_frames_within, parse_fps
from motionkit.fields.interpolation import INTERPOLATORS, Method, interpolator_of
from motionkit.fields.motion_field import Joints, MotionEncoder, MotionField, Observation, Poses, Times, at_fps

if TYPE_CHECKING:
    from scipy.sparse import csr_array


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
    start = motion.timegrid.start_seconds
    span = (start, start + motion.timegrid.span_seconds)
    upsampled = begin_completion(Observation.of(motion), span, encoder, fps).motion()
    return upsampled.annotated_like(motion).logged(f"upsample {motion.fps} -> {fps} fps ({encoder.name})")


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
    """A motion at any framerate from its observed frames, at even or uneven times, before it is sampled.

    `span` are the times of the first and the last frame of the motion, observed or not. Observed frames that fall on
    the new grid, within a microsecond, are the given ones to the last bit (quaternions up to their sign, which follows
    their neighbours). An encoder that misses them leaves a jump there; `motionkit.fields.anchoring` removes it. The
    grid starts at the motion's first frame, or by whole frames earlier. Beyond both ends `hold` stands still (the
    zero-velocity row of tables), other interpolators go on at constant velocity.
    """
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


STOPBAND_DECIBEL = 80.0
PASSBAND = 0.8
_ROWS_AT_ONCE = 8192


def resample(motion: Motion, fps: Framerate, method: Method = "slerp") -> Motion:
    """The motion at any framerate: filtered below the new Nyquist frequency downwards, interpolated upwards.

    Upwards the frames of the motion that fall on the new grid are kept, and `method` (an interpolator,
    docs/motion-fields.md) makes the others. Raises `ValueError` for an invalid framerate or an unknown
    method.

    >>> motion = mk.read("walk.bvh")
    >>> mk.resample(motion, 59.94).fps, mk.resample(motion, "120", "squad").num_frames
    (Fraction(60000, 1001), 479)
    """
    rate = parse_fps(fps)
    interpolator = interpolator_of(method)
    return _downsampled(motion, rate) if rate < motion.fps else upsample(motion, rate, interpolator)


def _downsampled(motion: Motion, fps: Fraction) -> Motion:
    """The motion at a lower framerate, filtered below the new Nyquist frequency.

    Where there are local rotations, these, the root and the bones are filtered and the positions follow by forward
    kinematics, so that the three agree; quaternions are filtered as four numbers and normalised.
    """
    rates = (motion.fps, fps)
    rotations, translation = None, motion.root_translation
    if motion.local_rotations is None:
        positions = _resample(motion.joint_positions, *rates).astype(np.float32)
    else:
        joints = Joints.of(Poses.of(motion), motion.skeleton)
        filtered = _resample(continuous_quaternions(joints.rotations), *rates)
        filtered /= np.linalg.norm(filtered, axis=-1, keepdims=True)
        positions = Joints(filtered, _resample(joints.bones, *rates), _resample(joints.root, *rates)).positions(
            motion.skeleton
        )
        rotations = filtered.astype(np.float32)
    sampled = Motion(
        joint_positions=positions,
        skeleton=motion.skeleton,
        timegrid=TimeGrid(fps, len(positions), motion.timegrid.start_seconds),
        local_rotations=rotations,
        root_translation=None if translation is None else _resample(translation, *rates).astype(np.float32),
    )
    return sampled.annotated_like(motion).logged(f"downsample {motion.fps} -> {fps} fps (low-pass)")


def resample_positions(
    positions: Float[np.ndarray, "frames joints 3"], fps_from: Fraction, fps_to: Fraction
) -> Float[np.ndarray, "new_frames joints 3"]:
    """Joint positions at another framerate, band-limited: output frame k is at k / fps_to, without delay.

    Windowed-sinc kernels (Kaiser, 80 dB) are evaluated at the exact fraction of a frame. Downwards the passband ends
    at 0.8 of the new Nyquist frequency and the stopband begins at it, so nothing folds back. Upwards the cut-off is the
    old Nyquist frequency, which keeps the given frames exactly. Beyond both ends the motion is continued by point
    reflection about its end pose, so speed is continuous there. Equal rates give a copy; dtype is kept.
    """
    if fps_from == fps_to:
        return positions.copy()
    return _resample(positions, fps_from, fps_to).astype(positions.dtype)


def _resample(
    values: Float[np.ndarray, "frames *rest"], fps_from: Fraction, fps_to: Fraction
) -> Float64[np.ndarray, "new_frames *rest"]:
    """Band-limited resampling along the first axis, in float64."""
    flat = values.reshape(len(values), -1).astype(np.float64)
    num_rows = num_frames_within(float((len(values) - 1) / fps_from), fps_to)
    if len(values) == 1:
        return flat.reshape(values.shape)
    ratio = fps_from / fps_to
    reach, cutoff = kernel_shape(ratio)
    margin = reach + 1
    padded = np.pad(flat, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    result = np.empty((num_rows, flat.shape[1]))
    for start in range(0, num_rows, _ROWS_AT_ONCE):
        rows = np.arange(start, min(start + _ROWS_AT_ONCE, num_rows))
        # k·p/q in integers, so that long motions don't accumulate rounding errors.
        whole, remainder = np.divmod(rows * ratio.numerator, ratio.denominator)
        result[rows] = kernel_matrix(whole + margin, remainder / ratio.denominator, len(padded), reach, cutoff) @ padded
    return result.reshape(num_rows, *values.shape[1:])


def kernel_matrix(
    sample: Int64[np.ndarray, "times"], fraction: Times, num_samples: int, reach: int, cutoff: float
) -> "csr_array":
    """The sparse matrix [times, num_samples] that evaluates samples `fraction` of a sample after sample `sample`.

    Reach and cut-off are those of `kernel_shape`. All samples within reach have to exist; the weights of a row add up
    to 1.
    """
    from scipy.sparse import csr_array

    taps = np.arange(-reach, reach + 1)
    phases, phase_of_row = np.unique(fraction, return_inverse=True)
    distance = phases[:, None] - taps
    beta = 0.1102 * (STOPBAND_DECIBEL - 8.7)
    window = np.i0(beta * np.sqrt(np.maximum(0.0, 1.0 - (distance / (reach + 1)) ** 2)))
    weights = window * np.sinc(2 * cutoff * distance)
    weights /= weights.sum(axis=1, keepdims=True)
    columns = sample[:, None] + taps
    pointers = np.arange(len(sample) + 1) * len(taps)
    return csr_array((weights[phase_of_row].ravel(), columns.ravel(), pointers), shape=(len(sample), num_samples))


def kernel_shape(ratio: Fraction) -> tuple[int, float]:
    """Half-length in source frames and cut-off in cycles per source frame of the Kaiser-windowed sinc.

    Length: Kaiser's formula N = (A − 7.95) / (2.285·Δω) (Oppenheim & Schafer, Discrete-Time Signal Processing, §7.5.3).
    """
    nyquist = 0.5 / max(float(ratio), 1.0)
    transition = (1.0 - PASSBAND) * nyquist
    cutoff = nyquist - transition / 2 if ratio > 1 else nyquist
    length = (STOPBAND_DECIBEL - 7.95) / (2.285 * 2 * np.pi * transition)
    return int(np.ceil(length / 2)), cutoff
