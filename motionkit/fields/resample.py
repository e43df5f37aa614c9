"""Any framerate to any other.

Upwards, a motion becomes a motion field (`motionkit.fields.completion.upsample`); downwards, everything above the new
Nyquist frequency is filtered out first. `resample_positions` is the band-limited function on bare arrays that
evaluators use both ways.
"""

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from motionkit.core.kinematics import continuous_quaternions
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float64, Int64
from motionkit.core.timegrid import Framerate, TimeGrid, num_frames_within, parse_fps
from motionkit.fields.completion import upsample
from motionkit.fields.interpolation import Method, interpolator_of
from motionkit.fields.joints import Joints
from motionkit.fields.motion_field import Poses, Times

if TYPE_CHECKING:
    from scipy.sparse import csr_array

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
