"""Damage of motion: graded corruptions, harmless transforms, and games, which hide damage from the figures.

An evaluator is calibrated with them: its clip-FID must rise with every family and stay flat under the transforms. The
learned evaluator is trained to regress the strength of some. These act on joint positions [..., frames, joints, 3] in
metres, y up, with one strength for all or one per clip, and preserve the dtype.

A game adds something to upsampled or low-passed motion: noise, at any time or at the right one, to positions or to
rotations, or the fast motion of other takes. It is won if no figure of clip-FID and the detail profile sees it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.interpolate

from eval.sets.motions import filtered, low_pass
from eval.sets.sets import SampleSet
from motionkit.core.shapes import Float, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.features import field

Array = npt.NDArray[np.floating]
Strength = float | Float64[np.ndarray, "*batch"]

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
    positions: Float[np.ndarray, "*batch frames joints 3"], frames: float = 0.5
) -> Float[np.ndarray, "*batch frames joints 3"]:
    """The motion `frames` (−1 … 1) later, by windowed-sinc interpolation: gain 1 up to 0.96 of the Nyquist frequency.

    The kernel (Kaiser, 80 dB) reaches 64 frames; without a window, a single frame's glitch would ring through the
    whole take.
    """
    reach = min(SHIFT_REACH_FRAMES, max(1, positions.shape[-3] - 1))
    taps = np.arange(-reach, reach + 1)
    distance = taps - frames
    inside = np.sqrt(np.maximum(0.0, 1.0 - (distance / (reach + 1)) ** 2))
    weights: npt.NDArray[np.float64] = np.sinc(distance) * np.i0(KAISER_BETA * inside)
    weights /= weights.sum()

    def transfer(frequencies: npt.NDArray[np.float64]) -> npt.NDArray[np.complex128]:
        return np.asarray(weights @ np.exp(2j * np.pi * np.outer(taps, frequencies)), dtype=np.complex128)

    return filtered(positions, transfer, frames)


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


NUM_GAMES = 3
"""Number of corruptions that `games` plays with."""
KEPT_FPS = 20.0
LOW_PASS_HZ = 8.0
TEXTURE_HZ = 10.0
NOISE_METRES = (0.0001, 0.0003, 0.001)
LANDING_NOISE_METRES = (0.0001, 0.0003, 0.0005, 0.001, 0.002)
TEXTURE_GAINS = (0.5, 1.0, 2.0)
FAST_METRES_PER_SECOND = 0.5
NUM_LENDERS = 4
FEET = [SMPL22.index(name) for name in ("left_ankle", "right_ankle", "left_foot", "right_foot")]
# A foot lands where it slows to this downward speed, near its own lowest height.
LANDING_METRES_PER_SECOND = 0.3
LANDING_METRES = 0.05
AFTER_LANDING_SECONDS = 0.12
# Windows that are compared to find the nearest training motion: their length, and poses, phases and number compared.
WINDOW_SECONDS = 0.5
POSES_COMPARED = 4
PHASES_PER_SECOND = 60
MAX_WINDOWS = 60_000
WINDOWS_AT_ONCE = 256
Take = npt.NDArray[np.float32]
Noise = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Games:
    """A plain corruption, and the same with cheats on top: sets of the same takes, by name."""

    parent: str
    honest: SampleSet
    cheats: dict[str, SampleSet]


def games(real: SampleSet, seed: int = 0, training: SampleSet | None = None) -> Iterator[Games]:
    """Upsampled and low-passed motion, each plain and disguised; one corruption at a time.

    With `training` motion at the framerate of `real`, some disguises add its fast part where its slow part is nearest.
    """
    fps = float(real.fps)
    rng = np.random.default_rng((seed, 7))
    upsampled = _with(real, [upsample_slerp(take[None], fps, KEPT_FPS, rng)[0] for take in real.sequences])
    slow = _with(real, [low_pass(take, fps, LOW_PASS_HZ) for take in real.sequences])
    slower = _with(real, [low_pass(take, fps, TEXTURE_HZ) for take in real.sequences])
    windows = None if training is None else _windows(training)
    if fps > KEPT_FPS:
        yield _games("upsampled from 20 fps", upsampled, real, seed, windows)
    yield _games("low-passed at 8 Hz", slow, real, seed, windows)
    name = "low-passed at 10 Hz"
    yield Games(name, slower, {f"{name} + fast part of another take": _borrowed(slower, real, seed)})


def _games(parent: str, honest: SampleSet, real: SampleSet, seed: int, windows: "_Windows | None") -> Games:
    cheats = {}
    for kind, noise in NOISES.items():
        for metres in LANDING_NOISE_METRES if kind == LANDINGS else NOISE_METRES:
            rng = np.random.default_rng((seed, 8))
            noisy = [take + metres * noise(take, real, rng) for take in honest.sequences]
            cheats[f"{parent} + {kind}, {1000 * metres:g} mm"] = _with(honest, noisy)
            if kind in TIMED:
                rigid = [with_bones_of(each, take) for each, take in zip(noisy, honest.sequences, strict=True)]
                cheats[f"{parent} + {kind}, {1000 * metres:g} mm, of rotations"] = _with(honest, rigid)
    cheats[f"{parent} + fast part of another take"] = _borrowed(honest, real, seed)
    if windows is not None:
        fast = [windows.fast_motion(take) for take in honest.sequences]
        for gain in TEXTURE_GAINS:
            takes = [take + gain * each for take, each in zip(honest.sequences, fast, strict=True)]
            cheats[f"{parent} + {ALIGNED} × {gain:g}"] = _with(honest, takes)
    return Games(parent, honest, cheats)


def _white(take: Take, like: SampleSet, rng: np.random.Generator) -> Noise:
    return rng.standard_normal(take.shape)


def _pink(take: Take, like: SampleSet, rng: np.random.Generator) -> Noise:
    """Power as 1 / f above 1 Hz; unit variance."""
    spectrum: npt.NDArray[np.complex128] = scipy.fft.rfft(rng.standard_normal(take.shape), axis=0)
    gain = 1.0 / np.sqrt(np.maximum(scipy.fft.rfftfreq(len(take), 1 / float(like.fps)), 1.0))
    gain /= np.sqrt(np.mean(gain**2))
    return np.asarray(scipy.fft.irfft(spectrum * gain[:, None, None], n=len(take), axis=0), dtype=np.float64)


def _on_fast_joints(take: Take, like: SampleSet, rng: np.random.Generator) -> Noise:
    """White noise on the half of the joints that move fastest over the take."""
    speed = _speed(take, like).mean(axis=0)
    fast = speed > np.median(speed)
    noise: Noise = rng.standard_normal(take.shape) * fast[:, None]
    return noise


def _while_joints_are_fast(take: Take, like: SampleSet, rng: np.random.Generator) -> Noise:
    """White noise on every joint while it moves at 0.5 m/s or more: noise that follows the motion."""
    return rng.standard_normal(take.shape) * (_speed(take, like) >= FAST_METRES_PER_SECOND)[..., None]


def _after_landings(take: Take, like: SampleSet, rng: np.random.Generator) -> Noise:
    """White noise on every joint for 0.12 s after a foot lands."""
    fps, heights = float(like.fps), take[:, FEET, 1].astype(np.float64)
    falls = np.gradient(heights, axis=0) * fps < -LANDING_METRES_PER_SECOND
    low = heights < np.percentile(heights, 5, axis=0) + LANDING_METRES
    landings = np.flatnonzero((falls[:-1] & ~falls[1:] & low[1:]).any(axis=1)) + 1
    noisy = np.zeros(len(take), dtype=bool)
    for frame in landings:
        noisy[frame : frame + round(AFTER_LANDING_SECONDS * fps)] = True
    return rng.standard_normal(take.shape) * noisy[:, None, None]


def _by_vertical_acceleration(take: Take, like: SampleSet, rng: np.random.Generator) -> Noise:
    """White noise on every joint, as strong as its vertical acceleration; of unit strength on average."""
    acceleration = np.abs(np.gradient(np.gradient(take[..., 1].astype(np.float64), axis=0), axis=0))
    share = acceleration / np.maximum(acceleration.mean(axis=0), 1e-12)
    noise: Noise = rng.standard_normal(take.shape) * share[..., None]
    return noise


LANDINGS = "noise after landings"
NOISES: dict[str, Callable[[Take, SampleSet, np.random.Generator], Noise]] = {
    "white noise": _white,
    "pink noise": _pink,
    "noise on fast joints": _on_fast_joints,
    "noise while joints are fast": _while_joints_are_fast,
    LANDINGS: _after_landings,
    "noise by vertical acceleration": _by_vertical_acceleration,
}
ALIGNED = "fast part of the nearest training motion"
TIMED = (LANDINGS, "noise by vertical acceleration")
"""Noises that follow slow motion."""


def with_bones_of(
    noisy: Float64[np.ndarray, "frames 22 3"], take: Float[np.ndarray, "frames 22 3"]
) -> Float64[np.ndarray, "frames 22 3"]:
    """The directions of a noisy motion's bones at the lengths that they have in another, built from its root."""
    built = noisy.copy()
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        bone = noisy[:, joint] - noisy[:, parent]
        length = np.linalg.norm(take[:, joint] - take[:, parent], axis=-1, keepdims=True)
        built[:, joint] = built[:, parent] + bone * length / np.maximum(
            np.linalg.norm(bone, axis=-1, keepdims=True), 1e-9
        )
    return built


def _speed(take: Take, like: SampleSet) -> Noise:
    """Speed of every joint in every frame, in m/s."""
    speed: Noise = np.linalg.norm(np.gradient(take.astype(np.float64), axis=0), axis=-1) * float(like.fps)
    return speed


def _borrowed(honest: SampleSet, real: SampleSet, seed: int) -> SampleSet:
    """Add the motion above 10 Hz of other, random takes, repeated if shorter.

    Every take is included `NUM_LENDERS` times with different lenders, since the fast part of one take may by chance fit
    the motion of another.
    """
    rng, takes = np.random.default_rng((seed, 9)), list(real.sequences)
    fast = [take - low_pass(take, float(real.fps), TEXTURE_HZ) for take in takes]
    others = max(1, len(takes) - 1)
    made = []
    for index, take in enumerate(honest.sequences):
        steps = 1 + rng.permutation(others)[np.arange(NUM_LENDERS) % others]
        made += [take + np.resize(fast[(index + step) % len(takes)], take.shape) for step in steps]
    each = honest.select(np.repeat(np.arange(honest.num_sequences), NUM_LENDERS))
    return _with(each, made)


@dataclass(frozen=True, eq=False)
class _Windows:
    """Windows of training motion below 8 Hz, for comparison, and the motion above 8 Hz that goes with them.

    `poses` [windows, numbers] are relative to place and heading (`yaw`) of a window's middle pose; `first` are frames
    of `fast`.
    """

    fps: float
    poses: npt.NDArray[np.float32]
    yaw: npt.NDArray[np.float32]
    fast: tuple[Take, ...]
    take: npt.NDArray[np.int64]
    first: npt.NDArray[np.int64]

    def fast_motion(self, take: Take) -> Noise:
        """The fast motion of the windows that are nearest to a take, cross-faded every half window."""
        length = _frames(self.fps)
        starts = np.unique(np.append(np.arange(0, len(take) - length, length // 2), len(take) - length))
        if starts[0] < 0:
            return np.zeros(take.shape)
        poses, yaw = _compared(take, starts, self.fps)
        squares = np.square(self.poses).sum(axis=1)
        added, weight = np.zeros(take.shape), np.full(len(take), 1e-6)
        fade = np.hanning(length + 2)[1:-1]
        for chunk in np.split(np.arange(len(starts)), range(WINDOWS_AT_ONCE, len(starts), WINDOWS_AT_ONCE)):
            nearest = np.argmin(squares - 2.0 * poses[chunk] @ self.poses.T, axis=1)
            for row, window in zip(chunk, nearest, strict=True):
                first = self.first[window]
                fast = self.fast[self.take[window]][first : first + length]
                place = slice(starts[row], starts[row] + length)
                added[place] += fade[:, None, None] * turn(fast, float(yaw[row] - self.yaw[window]))
                weight[place] += fade
        return np.asarray(added / weight[:, None, None])


def _windows(training: SampleSet) -> _Windows:
    fps, length = float(training.fps), _frames(float(training.fps))
    takes = [take for take in training.sequences if len(take) >= length]
    slow = [low_pass(take, fps, LOW_PASS_HZ) for take in takes]
    every = max(1, round(fps / PHASES_PER_SECOND), sum(map(len, takes)) // MAX_WINDOWS)
    starts = [np.arange(0, len(take) - length + 1, every) for take in takes]
    poses, yaw = zip(*(_compared(take, each, fps) for take, each in zip(slow, starts, strict=True)), strict=True)
    return _Windows(
        fps=fps,
        poses=np.concatenate(poses),
        yaw=np.concatenate(yaw),
        fast=tuple(take - low for take, low in zip(takes, slow, strict=True)),
        take=np.repeat(np.arange(len(takes)), [len(each) for each in starts]),
        first=np.concatenate(starts),
    )


def _compared(
    take: Take, starts: npt.NDArray[np.int64], fps: float
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Poses [windows, numbers] of a take's windows relative to place and heading of their middle, and the headings."""
    length = _frames(fps)
    yaw, origin = field.window_frame(take[starts + length // 2])
    rows = starts[:, None] + np.linspace(0, length - 1, POSES_COMPARED).round().astype(np.int64)
    return field.to_window(take[rows], yaw, origin).reshape(len(starts), -1), yaw


def _frames(fps: float) -> int:
    return max(2, round(WINDOW_SECONDS * fps))


def _with(samples: SampleSet, takes: Sequence[npt.NDArray[np.floating]]) -> SampleSet:
    return samples.with_positions(samples.name, samples.fps, [take.astype(np.float32) for take in takes])
