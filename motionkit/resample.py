"""Any framerate to any other.

Upwards, a motion becomes a motion field (linear, SLERP or cubic) that is sampled where one likes; downwards, everything
above the new Nyquist frequency is filtered out first. `resample_positions` is the band-limited function on bare arrays
that evaluators use both ways.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from motionkit import kinematics
from motionkit.motion import Motion
from motionkit.motionfield import Poses, check_times, to_motion
from motionkit.skeleton import Skeleton
from motionkit.timegrid import TimeGrid, num_frames_within

Method = Literal["linear", "slerp", "cubic"]

STOPBAND_DECIBEL = 80.0
PASSBAND = 0.8
_ROWS_AT_ONCE = 8192
# An instant this close to a frame, in frames, is that frame: time stamps are rounded to float64, frames are not.
_SNAP_FRAMES = 1e-6


# Poses between frames: the frames before and after each instant, and how far between them it lies.
Interpolation = Callable[[Int[np.ndarray, "times"], Int[np.ndarray, "times"], Float64[np.ndarray, "times"]], Poses]


@dataclass(frozen=True, eq=False)
class FrameField:
    """A motion as a `MotionField`, from its first frame to its last; `interpolate` says what lies between frames."""

    motion: Motion
    interpolate: Interpolation

    @property
    def skeleton(self) -> Skeleton:
        """The motion's skeleton."""
        return self.motion.skeleton

    @property
    def start_seconds(self) -> float:
        """Time of the first frame."""
        return self.motion.timegrid.start_seconds

    @property
    def end_seconds(self) -> float:
        """Time of the last frame."""
        return self.motion.timegrid.start_seconds + self.motion.timegrid.span_seconds

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        check_times(self, times_seconds)
        last = self.motion.num_frames - 1
        place = (times_seconds - self.start_seconds) * float(self.motion.fps)
        nearest = np.rint(place)
        place = np.clip(np.where(np.abs(place - nearest) < _SNAP_FRAMES, nearest, place), 0, last)
        before = np.floor(place).astype(np.int64)
        return self.interpolate(before, np.minimum(before + 1, last), place - before)


def linear_field(motion: Motion) -> FrameField:
    """Joint positions on straight lines between frames; bones shorten between frames that turn."""

    def interpolate(
        before: Int[np.ndarray, "times"], after: Int[np.ndarray, "times"], fraction: Float64[np.ndarray, "times"]
    ) -> Poses:
        return Poses(_lerp(motion.joint_positions, before, after, fraction).astype(np.float32))

    return FrameField(motion, interpolate)


@dataclass(frozen=True, eq=False)
class _Joints:
    """Frames taken apart: local rotations (no sign flips in time), bones in their parent's frame, root position."""

    rotations: Float64[np.ndarray, "frames joints 4"]
    bones: Float64[np.ndarray, "frames joints 3"]
    root: Float64[np.ndarray, "frames 3"]

    @classmethod
    def of(cls, motion: Motion) -> "_Joints":
        local = motion.local_rotations
        if local is None:
            local = kinematics.inverse_kinematics(motion.joint_positions, motion.skeleton)
        rotations = continuous_quaternions(local.astype(np.float64))
        positions = motion.joint_positions.astype(np.float64)
        parents = list(motion.skeleton.parents[1:])
        world = kinematics.global_rotations(rotations, motion.skeleton)
        bones = np.zeros_like(positions)
        bones[:, 1:] = kinematics.quaternion_rotate(
            kinematics.quaternion_conjugate(world[:, parents]), positions[:, 1:] - positions[:, parents]
        )
        return cls(rotations, bones, positions[:, 0])

    def positions(self, skeleton: Skeleton) -> Float32[np.ndarray, "frames joints 3"]:
        """Forward kinematics."""
        return kinematics.forward_kinematics(self.rotations, self.root, skeleton, self.bones).astype(np.float32)


def slerp_field(motion: Motion) -> FrameField:
    """Local rotations on great arcs between frames, the root on straight lines, positions by forward kinematics.

    Bones are taken in their parent's frame as observed and interpolated linearly, so given frames are exact also where
    the skeleton's rest offsets are not quite the source's. Motions without rotations get those of
    `kinematics.inverse_kinematics`; as these are not observed, the poses then carry none. Source: Shoemake 1985.
    """
    frames = _Joints.of(motion)
    true_rotations, translation = motion.local_rotations is not None, motion.root_translation

    def interpolate(
        before: Int[np.ndarray, "times"], after: Int[np.ndarray, "times"], fraction: Float64[np.ndarray, "times"]
    ) -> Poses:
        between = _Joints(
            rotations=kinematics.quaternion_slerp(
                frames.rotations[before],
                frames.rotations[after],
                np.broadcast_to(fraction[:, None], (len(fraction), 1)),
            ),
            bones=_lerp(frames.bones, before, after, fraction),
            root=_lerp(frames.root, before, after, fraction),
        )
        return Poses(
            joint_positions=between.positions(motion.skeleton),
            local_rotations=between.rotations.astype(np.float32) if true_rotations else None,
            root_translation=None
            if translation is None
            else _lerp(translation, before, after, fraction).astype(np.float32),
        )

    return FrameField(motion, interpolate)


def cubic_field(motion: Motion) -> FrameField:
    """Joint positions on a cubic spline through all frames (not-a-knot ends): continuous velocity and acceleration."""
    from scipy.interpolate import CubicSpline

    if motion.num_frames == 1:
        return linear_field(motion)
    values = motion.joint_positions.reshape(motion.num_frames, -1).astype(np.float64)
    spline = CubicSpline(np.arange(motion.num_frames, dtype=np.float64), values)

    def interpolate(
        before: Int[np.ndarray, "times"], _after: Int[np.ndarray, "times"], fraction: Float64[np.ndarray, "times"]
    ) -> Poses:
        positions = spline(before + fraction).reshape(len(before), *motion.joint_positions.shape[1:])
        return Poses(positions.astype(np.float32))

    return FrameField(motion, interpolate)


FIELDS: dict[Method, Callable[[Motion], FrameField]] = {
    "linear": linear_field,
    "slerp": slerp_field,
    "cubic": cubic_field,
}


def upsample(motion: Motion, fps: Fraction, method: Method = "slerp") -> Motion:
    """The motion at a higher framerate, interpolated; every frame of the source that falls on the new grid is kept.

    Raises `ValueError` where `fps` is below the motion's.
    """
    if fps < motion.fps:
        raise ValueError(f"{fps} fps is less than the motion's {motion.fps}: use downsample, which filters first")
    if fps == motion.fps:
        return motion
    sampled = to_motion(FIELDS[method](motion), fps)
    return _with_annotations(sampled, motion, f"upsample {motion.fps} -> {fps} fps ({method})")


def downsample(motion: Motion, fps: Fraction) -> Motion:
    """The motion at a lower framerate, filtered below the new Nyquist frequency (see `resample_positions`).

    Where there are local rotations, these, the root and the bones are filtered and the positions follow by forward
    kinematics, so that the three agree; quaternions are filtered as four numbers and normalised. Raises `ValueError`
    where `fps` is above the motion's.
    """
    if fps > motion.fps:
        raise ValueError(f"{fps} fps is more than the motion's {motion.fps}: use upsample")
    if fps == motion.fps:
        return motion
    rates = (motion.fps, fps)
    rotations, translation = None, motion.root_translation
    if motion.local_rotations is None:
        positions = _resample(motion.joint_positions, *rates).astype(np.float32)
    else:
        joints = _Joints.of(motion)
        filtered = _resample(joints.rotations, *rates)
        filtered /= np.linalg.norm(filtered, axis=-1, keepdims=True)
        positions = _Joints(filtered, _resample(joints.bones, *rates), _resample(joints.root, *rates)).positions(
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
    return _with_annotations(sampled, motion, f"downsample {motion.fps} -> {fps} fps (low-pass)")


def resample(motion: Motion, fps: Fraction, method: Method = "slerp") -> Motion:
    """The motion at any framerate: `downsample` below its own, `upsample` by `method` above it."""
    return downsample(motion, fps) if fps < motion.fps else upsample(motion, fps, method)


def resample_positions(
    positions: Float[np.ndarray, "frames joints 3"], fps_from: Fraction, fps_to: Fraction
) -> Float[np.ndarray, "new_frames joints 3"]:
    """Joint positions at another framerate, band-limited: frame k of the answer is at k / fps_to, without delay.

    Windowed-sinc kernels (Kaiser, 80 dB) are evaluated at the exact fraction of a frame. Downwards the passband ends
    at 0.8 of the new Nyquist frequency and the stopband begins at it, so nothing folds back. Upwards the cut-off is the
    old Nyquist frequency, which keeps the given frames exactly. Beyond both ends the motion is continued by point
    reflection about its end pose, so speed is continuous there. Equal rates give a copy; dtype is kept.
    """
    if fps_from == fps_to:
        return positions.copy()
    return _resample(positions, fps_from, fps_to).astype(positions.dtype)


def slerp_upsample_positions(
    positions: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton, fps_from: Fraction, fps_to: Fraction
) -> Float32[np.ndarray, "new_frames joints 3"]:
    """Joint positions at a higher framerate by `slerp_field` on rotations from inverse kinematics.

    Raises `ValueError` where `fps_to` is below `fps_from`.
    """
    grid = TimeGrid(fps_from, len(positions))
    motion = Motion(joint_positions=positions.astype(np.float32), skeleton=skeleton, timegrid=grid)
    return upsample(motion, fps_to, "slerp").joint_positions


def continuous_quaternions(
    q: Float[np.ndarray, "frames joints 4"],
) -> Float[np.ndarray, "frames joints 4"]:
    """The same rotations with signs chosen so that consecutive quaternions lie on the same half of the sphere."""
    flips = np.sum(q[1:] * q[:-1], axis=-1) < 0
    odd = np.cumsum(flips, axis=0) % 2 == 1
    result = q.copy()
    result[1:][odd] *= -1
    return result


def _with_annotations(sampled: Motion, source: Motion, operation: str) -> Motion:
    return replace(
        sampled,
        captions=source.captions,
        action=source.action,
        style=source.style,
        split=source.split,
        sequence_id=source.sequence_id,
        provenance=source.provenance,
    ).logged(operation)


def _lerp(
    values: Float[np.ndarray, "frames *rest"],
    before: Int[np.ndarray, "times"],
    after: Int[np.ndarray, "times"],
    fraction: Float64[np.ndarray, "times"],
) -> Float64[np.ndarray, "times *rest"]:
    weight = fraction.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray((1.0 - weight) * values[before] + weight * values[after])


def _resample(
    values: Float[np.ndarray, "frames *rest"], fps_from: Fraction, fps_to: Fraction
) -> Float64[np.ndarray, "new_frames *rest"]:
    """Band-limited resampling along the first axis, in float64."""
    from scipy.sparse import csr_array

    flat = values.reshape(len(values), -1).astype(np.float64)
    num_rows = num_frames_within(float((len(values) - 1) / fps_from), fps_to)
    if len(values) == 1:
        return flat.reshape(values.shape)
    ratio = fps_from / fps_to
    reach, cutoff = _kernel_shape(ratio)
    margin = reach + 1
    padded = np.pad(flat, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    taps = np.arange(-reach, reach + 1)
    result = np.empty((num_rows, flat.shape[1]))
    for start in range(0, num_rows, _ROWS_AT_ONCE):
        rows = np.arange(start, min(start + _ROWS_AT_ONCE, num_rows))
        # k·p/q in integers: a long take loses nothing to rounding.
        whole, remainder = np.divmod(rows * ratio.numerator, ratio.denominator)
        phases, phase_of_row = np.unique(remainder, return_inverse=True)
        weights = _kernel(phases[:, None] / ratio.denominator - taps, reach, cutoff)
        weights /= weights.sum(axis=1, keepdims=True)
        columns = whole[:, None] + taps + margin
        pointers = np.arange(len(rows) + 1) * len(taps)
        matrix = csr_array((weights[phase_of_row].ravel(), columns.ravel(), pointers), shape=(len(rows), len(padded)))
        result[rows] = matrix @ padded
    return result.reshape(num_rows, *values.shape[1:])


def _kernel_shape(ratio: Fraction) -> tuple[int, float]:
    """Half-length in source frames and cut-off in cycles per source frame of the Kaiser-windowed sinc.

    Length: Kaiser's formula N = (A − 7.95) / (2.285·Δω) (Oppenheim & Schafer, Discrete-Time Signal Processing, §7.5.3).
    """
    nyquist = 0.5 / max(float(ratio), 1.0)
    transition = (1.0 - PASSBAND) * nyquist
    cutoff = nyquist - transition / 2 if ratio > 1 else nyquist
    length = (STOPBAND_DECIBEL - 7.95) / (2.285 * 2 * np.pi * transition)
    return int(np.ceil(length / 2)), cutoff


def _kernel(
    distance: Float64[np.ndarray, "phases taps"], reach: int, cutoff: float
) -> Float64[np.ndarray, "phases taps"]:
    beta = 0.1102 * (STOPBAND_DECIBEL - 8.7)
    inside = np.sqrt(np.maximum(0.0, 1.0 - (distance / (reach + 1)) ** 2))
    window: Float64[np.ndarray, "phases taps"] = np.i0(beta * inside)
    return window * np.sinc(2 * cutoff * distance)
