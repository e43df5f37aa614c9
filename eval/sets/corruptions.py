"""Graded corruptions of motion with continuous strengths, and harmless transforms.

An evaluator is calibrated with them (its clip-FID must rise with every family and stay flat under the transforms) and
the learned evaluator is trained to regress their strength. All act on joint positions [..., frames, joints, 3] in
metres, y up, with one strength for all or one per clip, and preserve the dtype.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.interpolate

from motionkit.core.shapes import Float, Float64
from motionkit.core.skeleton import SMPL22, Skeleton

Array = npt.NDArray[np.floating]
Strength = float | Float64[np.ndarray, "*batch"]

LOW_PASS_ORDER = 4
SHIFT_REACH_FRAMES = 64
FEET = [7, 8, 10, 11]
KAISER_BETA = 7.857
"""80 dB of attenuation beside the passband (Kaiser's formula, 0.1102 · (80 − 8.7))."""


@dataclass(frozen=True)
class Family:
    """A family of corruptions, graded from `mildest` to `severest` strength.

    `kind`: an "amplitude" is worse the larger (metres, metres per second); a "rate" is worse the smaller (frames per
    second kept, cut-off in Hz) and harmless from `fps × clean_at` on. `levels` are those of the calibration of
    clip-fid/1, mild to severe.
    """

    name: str
    unit: str
    kind: Literal["amplitude", "rate"]
    levels: tuple[float, ...]
    mildest: float
    severest: float
    clean_at: float
    corrupt: Callable[[Array, float, float | npt.NDArray[np.float64], np.random.Generator], Array]

    def levels_at(self, fps: float) -> tuple[float, ...]:
        """The calibration's levels that have an effect at this framerate, mild to severe."""
        if self.kind == "amplitude":
            return self.levels
        return tuple(level for level in self.levels if level < fps * self.clean_at)

    def severity(self, strength: Float64[np.ndarray, "*n"], fps: float) -> Float64[np.ndarray, "*n"]:
        """Log strength as a regression target: 0 where nothing changes, rising with the damage.

        Amplitudes: log(1 + strength / (mildest / 2)); rates: log(fps × clean_at / strength), never below 0.
        """
        if self.kind == "amplitude":
            return np.log1p(strength / (0.5 * self.mildest))
        return np.maximum(np.log(fps * self.clean_at / strength), 0.0)

    def draw(self, rng: np.random.Generator, fps: float, num: int) -> Float64[np.ndarray, "num"]:
        """Strengths drawn log-uniformly between the mildest with an effect at `fps` and the severest."""
        mildest = self.mildest if self.kind == "amplitude" else min(self.mildest, fps * self.clean_at)
        low, high = sorted((mildest, self.severest))
        return np.exp(rng.uniform(np.log(low), np.log(high), num))


def families(skeleton: Skeleton = SMPL22) -> tuple[Family, ...]:
    """Every family, for motions on a skeleton: two ways of upsampling, foot sliding, joint jitter, low-pass."""
    rates = (60.0, 40.0, 30.0, 20.0, 15.0, 10.0)
    slerp = partial(upsample_slerp, parents=skeleton.parents)
    return (
        Family("upsampling-slerp", "fps", "rate", rates, 100.0, 8.0, 1.0, slerp),
        Family("upsampling-linear", "fps", "rate", rates, 100.0, 8.0, 1.0, upsample_linear),
        Family("foot-sliding", "m/s", "amplitude", (0.01, 0.02, 0.05, 0.1, 0.2), 0.005, 0.3, 0.0, slide),
        Family("jitter", "m", "amplitude", (0.0005, 0.001, 0.002, 0.005, 0.01), 0.00025, 0.015, 0.0, jitter),
        Family("low-pass", "Hz", "rate", (20.0, 10.0, 5.0, 3.0), 30.0, 2.0, 0.5, _corrupt_low_pass),
    )


def damages(skeleton: Skeleton = SMPL22) -> tuple[Family, ...]:
    """What calibration damages motion with: the families that the learned evaluator regresses, and further ones."""
    rates = (60.0, 40.0, 30.0, 20.0, 15.0, 10.0)
    return (
        *families(skeleton),
        Family("upsampling-cubic", "fps", "rate", rates, 100.0, 8.0, 1.0, _corrupt_cubic),
        Family("floor-height", "m", "amplitude", (0.05, 0.1, 0.2, 0.3), 0.02, 0.5, 0.0, _lower),
        Family("time-reversed", "of the frames", "amplitude", (1.0,), 0.5, 1.0, 0.0, _reverse),
        Family("frozen-feet", "of the way", "amplitude", (0.25, 0.5, 1.0), 0.1, 1.0, 0.0, _freeze_feet),
        Family("pops", "m", "amplitude", (0.02, 0.05, 0.1), 0.01, 0.2, 0.0, _pop),
    )


def upsample_linear(
    positions: Float[np.ndarray, "*batch frames joints 3"],
    fps: float,
    kept_fps: Strength,
    rng: np.random.Generator,
) -> Float[np.ndarray, "*batch frames joints 3"]:
    """Keep only the poses at `kept_fps` frames a second and interpolate joint positions linearly between them.

    The phase of the kept poses is drawn per clip; the clip's first and last pose are kept too. Poses between two frames
    of `positions` are read from a Catmull-Rom spline.
    """
    flat, kept = _flatten(positions, kept_fps)
    before, after, fraction = _knots(flat, fps, kept, rng)
    u = fraction[..., None, None]
    return _restore((1 - u) * before + u * after, positions)


def upsample_slerp(
    positions: Float[np.ndarray, "*batch frames joints 3"],
    fps: float,
    kept_fps: Strength,
    rng: np.random.Generator,
    parents: tuple[int, ...] = SMPL22.parents,
) -> Float[np.ndarray, "*batch frames joints 3"]:
    """Keep only the poses at `kept_fps` and turn every bone along the great circle between them; the root is linear.

    Positions carry no twist, so each bone's direction is slerped in the world and its length interpolated: bones stay
    rigid, as under SLERP of joint rotations (Shoemake 1985). Knots as in `upsample_linear`.
    """
    flat, kept = _flatten(positions, kept_fps)
    before, after, fraction = _knots(flat, fps, kept, rng)
    above = np.array(parents[1:])
    bones = _slerp_bones(before[:, :, 1:] - before[:, :, above], after[:, :, 1:] - after[:, :, above], fraction)
    u = fraction[..., None]
    result = np.empty_like(before)
    result[:, :, 0] = (1 - u) * before[:, :, 0] + u * after[:, :, 0]
    for joint, parent in enumerate(parents[1:], start=1):
        result[:, :, joint] = result[:, :, parent] + bones[:, :, joint - 1]
    return _restore(result, positions)


def slide(
    positions: Float[np.ndarray, "*batch frames joints 3"],
    fps: float,
    metres_per_second: Strength,
    rng: np.random.Generator,
) -> Float[np.ndarray, "*batch frames joints 3"]:
    """Let the whole body drift horizontally at a constant speed, in a direction drawn per clip: planted feet slide."""
    flat, speed = _flatten(positions, metres_per_second)
    direction = rng.uniform(0, 2 * np.pi, len(flat))
    step = (speed / fps)[:, None] * np.stack((np.sin(direction), np.zeros_like(direction), np.cos(direction)), -1)
    drift = np.arange(flat.shape[1])[None, :, None] * step[:, None]
    return _restore(flat + drift[:, :, None], positions)


def jitter(
    positions: Float[np.ndarray, "*batch frames joints 3"],
    fps: float,
    metres: Strength,
    rng: np.random.Generator,
) -> Float[np.ndarray, "*batch frames joints 3"]:
    """Add independent Gaussian noise to every joint, axis and frame; `metres` is its standard deviation."""
    flat, deviation = _flatten(positions, metres)
    return _restore(flat + deviation[:, None, None, None] * rng.standard_normal(flat.shape), positions)


def low_pass(
    positions: Float[np.ndarray, "*batch frames joints 3"],
    fps: float,
    cutoff_hz: Strength,
    order: int = LOW_PASS_ORDER,
) -> Float[np.ndarray, "*batch frames joints 3"]:
    """Zero-phase Butterworth low-pass along time, half amplitude at the cut-off.

    The gain 1 / (1 + (f / cut-off)^(2·order)) is that of a Butterworth filter run forwards and backwards; the ends are
    continued by point reflection, so that constant motion and constant velocity pass unchanged.
    """
    flat, cutoff = _flatten(positions, cutoff_hz)
    return _restore(_filter(flat, lambda f: 1.0 / (1.0 + (f * fps / cutoff[:, None]) ** (2 * order))), positions)


def turn(
    positions: Float[np.ndarray, "*batch frames joints 3"], yaw_radians: Strength
) -> Float[np.ndarray, "*batch frames joints 3"]:
    """Rotate the whole motion about the vertical axis through the origin; evaluators must be invariant to it."""
    flat, yaw = _flatten(positions, yaw_radians)
    sine, cosine = np.sin(yaw)[:, None, None], np.cos(yaw)[:, None, None]
    x, y, z = np.moveaxis(flat, -1, 0)
    return _restore(np.stack((cosine * x + sine * z, y, cosine * z - sine * x), -1), positions)


def translate(
    positions: Float[np.ndarray, "*batch frames joints 3"], offset: Float64[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch frames joints 3"]:
    """Move the whole motion by a horizontal (x, z) offset in metres; evaluators must be invariant to it."""
    moved = positions.astype(np.float64)
    moved[..., (0, 2)] += offset[..., None, None, :]
    return moved.astype(positions.dtype)


def shift_between_frames(
    positions: Float[np.ndarray, "*batch frames joints 3"], frames: Strength = 0.5
) -> Float[np.ndarray, "*batch frames joints 3"]:
    """The motion `frames` (−1 … 1) later, by windowed-sinc interpolation: gain 1 up to 0.96 of the Nyquist frequency.

    The kernel (Kaiser, 80 dB) reaches 64 frames; without a window, a single frame's glitch would ring through the
    whole take.
    """
    flat, delay = _flatten(positions, frames)
    reach = min(SHIFT_REACH_FRAMES, max(1, flat.shape[1] - 1))
    taps = np.arange(-reach, reach + 1)
    distance = taps - delay[:, None]
    inside = np.sqrt(np.maximum(0.0, 1.0 - (distance / (reach + 1)) ** 2))
    weights: npt.NDArray[np.float64] = np.sinc(distance) * np.i0(KAISER_BETA * inside)
    weights /= weights.sum(axis=1, keepdims=True)

    def transfer(frequencies: npt.NDArray[np.float64]) -> npt.NDArray[np.complex128]:
        return np.asarray(weights @ np.exp(2j * np.pi * np.outer(taps, frequencies)), dtype=np.complex128)

    return _restore(_filter(flat, transfer, delay), positions)


def _corrupt_low_pass(
    positions: Array, fps: float, strength: float | npt.NDArray[np.float64], rng: np.random.Generator
) -> Array:
    return low_pass(positions, fps, strength)


def _corrupt_cubic(
    positions: Array, fps: float, strength: float | npt.NDArray[np.float64], rng: np.random.Generator
) -> Array:
    """Keep only the poses at so many frames a second, and read the others from a cubic spline through them."""
    flat, kept = _flatten(positions, strength)
    last, result = flat.shape[1] - 1, flat.copy()
    if last < 1:
        return positions.copy()
    for clip, spacing in enumerate(np.maximum(fps / kept, 1.0)):
        phase = spacing * rng.uniform() * (spacing > 1.0)
        knots, frames = np.unique(np.concatenate(([0.0], np.arange(phase, last, spacing), [last]))), np.arange(last + 1)
        poses = scipy.interpolate.CubicSpline(frames, flat[clip])(knots)
        result[clip] = scipy.interpolate.CubicSpline(knots, poses)(frames)
    return _restore(result, positions)


def _lower(positions: Array, fps: float, strength: float | npt.NDArray[np.float64], rng: np.random.Generator) -> Array:
    """Sink the whole body by so many metres."""
    flat, metres = _flatten(positions, strength)
    return _restore(flat - metres[:, None, None, None] * np.array([0.0, 1.0, 0.0]), positions)


def _reverse(
    positions: Array, fps: float, strength: float | npt.NDArray[np.float64], rng: np.random.Generator
) -> Array:
    """Play the motion backwards."""
    return positions[..., ::-1, :, :].copy()


def _freeze_feet(
    positions: Array, fps: float, strength: float | npt.NDArray[np.float64], rng: np.random.Generator
) -> Array:
    """Bring ankles and toes so far towards their mean places beside the root: with 1 they do not move beside it."""
    flat, share = _flatten(positions, strength)
    result = flat.copy()
    beside = flat[:, :, FEET] - flat[:, :, :1]
    result[:, :, FEET] += share[:, None, None, None] * (beside.mean(axis=1, keepdims=True) - beside)
    return _restore(result, positions)


def _pop(positions: Array, fps: float, strength: float | npt.NDArray[np.float64], rng: np.random.Generator) -> Array:
    """Displace one joint for one frame, about once a second, by so many metres in a random direction."""
    flat, metres = _flatten(positions, strength)
    result, (num_clips, num_frames, num_joints, _) = flat.copy(), flat.shape
    clip, frame = np.nonzero(rng.random((num_clips, num_frames)) < 1.0 / fps)
    direction = rng.standard_normal((len(clip), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    result[clip, frame, rng.integers(num_joints, size=len(clip))] += metres[clip, None] * direction
    return _restore(result, positions)


def _flatten(
    positions: Array, strength: float | npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Batch axes as one, in float64, with one strength per clip."""
    batch = positions.shape[:-3]
    flat = positions.reshape(-1, *positions.shape[-3:]).astype(np.float64)
    return flat, np.broadcast_to(np.asarray(strength, dtype=np.float64), batch).reshape(-1)


def _restore(flat: npt.NDArray[np.float64], like: Array) -> Array:
    return flat.reshape(like.shape).astype(like.dtype)


def _knots(
    flat: npt.NDArray[np.float64], fps: float, kept_fps: npt.NDArray[np.float64], rng: np.random.Generator
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The kept poses before and after every frame, and the frame's position between them (0 … 1)."""
    last = flat.shape[1] - 1
    spacing = np.maximum(fps / kept_fps, 1.0)[:, None]
    # At a spacing of one frame every pose is kept, so the knots must fall on the frames.
    phase = spacing * rng.uniform(size=(len(flat), 1)) * (spacing > 1.0)
    frame = np.arange(last + 1)[None]
    left = phase + np.floor((frame - phase) / spacing) * spacing
    before, after = np.clip(left, 0, last), np.clip(left + spacing, 0, last)
    gap = np.where(after > before, after - before, 1.0)
    return _sample(flat, before), _sample(flat, after), (frame - before) / gap


def _sample(flat: npt.NDArray[np.float64], frame: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Poses at fractional frame numbers [B, T] by a Catmull-Rom spline, exact on the frames."""
    last = flat.shape[1] - 1
    base = np.floor(frame).astype(np.int64)
    u = frame - base
    weights = (
        ((2 - u) * u - 1) * u / 2,
        ((3 * u - 5) * u * u + 2) / 2,
        ((4 - 3 * u) * u + 1) * u / 2,
        (u - 1) * u * u / 2,
    )
    clips = np.arange(len(flat))[:, None]
    # One frame more at either end by point reflection, so that constant velocity is met exactly up to the ends.
    head, tail = 2 * flat[:, :1] - flat[:, min(1, last), None], 2 * flat[:, -1:] - flat[:, max(last - 1, 0), None]
    padded = np.concatenate((head, flat, tail), axis=1)
    result = np.zeros_like(flat)
    for offset, weight in enumerate(weights):
        result += weight[..., None, None] * padded[clips, np.minimum(base + offset, last + 2)]
    return result


def _slerp_bones(
    before: npt.NDArray[np.float64], after: npt.NDArray[np.float64], fraction: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Bone vectors between two poses: directions along the great circle, lengths linear; opposite bones go linearly."""
    lengths = [np.linalg.norm(bones, axis=-1, keepdims=True) for bones in (before, after)]
    start, end = (bones / np.maximum(length, 1e-12) for bones, length in zip((before, after), lengths, strict=True))
    u = fraction[..., None, None]
    angle = np.arccos(np.clip(np.sum(start * end, axis=-1, keepdims=True), -1.0, 1.0))
    sine = np.sin(angle)
    straight = sine < 1e-6
    safe = np.where(straight, 1.0, sine)
    first = np.where(straight, 1 - u, np.sin((1 - u) * angle) / safe)
    second = np.where(straight, u, np.sin(u * angle) / safe)
    turned: npt.NDArray[np.float64] = (first * start + second * end) * ((1 - u) * lengths[0] + u * lengths[1])
    return turned


def _filter(
    flat: npt.NDArray[np.float64],
    gain: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.floating | np.complexfloating]],
    delay: float | npt.NDArray[np.float64] = 0.0,
) -> npt.NDArray[np.float64]:
    """Multiply the spectrum along frames by gain(cycles per frame) [B or 1, F]; point reflection continues the ends.

    `delay` says how many frames [B] the gain moves a motion, for the part that has no spectrum.
    """
    num_frames = flat.shape[1]
    if num_frames < 2:
        return flat
    pad = num_frames - 1
    head = 2 * flat[:, :1] - flat[:, pad:0:-1]
    tail = 2 * flat[:, -1:] - flat[:, -2::-1]
    padded = np.concatenate((head, flat, tail), axis=1)
    # After the reflection a step remains between both ends of the padded motion: remove the linear trend.
    slope = (padded[:, -1] - padded[:, 0]) / (padded.shape[1] - 1)
    line = padded[:, :1] + np.arange(padded.shape[1])[None, :, None, None] * slope[:, None]
    frequencies = scipy.fft.rfftfreq(padded.shape[1])
    spectrum = scipy.fft.rfft(padded - line, axis=1)
    spectrum *= gain(frequencies)[:, :, None, None]
    filtered = scipy.fft.irfft(spectrum, n=padded.shape[1], axis=1)
    line += np.asarray(delay).reshape(-1, 1, 1, 1) * slope[:, None]
    return np.asarray(filtered + line, dtype=np.float64)[:, pad : pad + num_frames]
