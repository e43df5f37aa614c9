"""Damage of motion: graded corruptions, harmless transforms, and games, which hide damage from the figures.

An evaluator is calibrated with them: its clip-FID must rise with every family and stay flat under the transforms. They
act on one motion: joint positions [frames, joints, 3] in metres, y up.

A game adds something to upsampled or low-passed motion: noise, at any time or at the right one, to positions or to
rotations, or the fast part of other motions. It is won if no figure of clip-FID and the detail profile sees it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from eval.sets.motions import filtered, low_pass
from eval.sets.sets import SampleSet
from motionkit.core.kinematics import rotate_about_y
from motionkit.core.shapes import Float, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.features import field

Positions = npt.NDArray[np.floating]
Noise = npt.NDArray[np.float64]
Damage = Callable[[Positions, float, float, np.random.Generator], Positions]
"""Changes a motion at a framerate by a strength."""

FEET = [SMPL22.index(name) for name in ("left_ankle", "right_ankle", "left_foot", "right_foot")]
SHIFT_REACH_FRAMES = 64
KAISER_BETA = 7.857
"""80 dB of attenuation beside the passband (Kaiser's formula, 0.1102 · (80 − 8.7))."""


def upsample_linear(motion: Positions, fps: float, kept_fps: float, rng: np.random.Generator) -> Positions:
    """Keep only the poses at `kept_fps` frames a second and interpolate joint positions linearly between them.

    The kept poses' phase is random; the first and last are kept too. Between frames poses are of a Catmull-Rom spline.
    """
    before, after, fraction = _kept_poses(motion, fps, kept_fps, rng)
    u = fraction[:, None, None]
    return np.asarray((1 - u) * before + u * after)


def upsample_slerp(motion: Positions, fps: float, kept_fps: float, rng: np.random.Generator) -> Positions:
    """Keep only the poses at `kept_fps` and turn every bone along the great circle between them; the root is linear.

    Positions carry no twist, so each bone's direction is slerped in the world and its length interpolated: bones stay
    rigid, as under SLERP of joint rotations (Shoemake 1985). Opposite directions go linearly. Kept poses as in
    `upsample_linear`.
    """
    before, after, fraction = _kept_poses(motion, fps, kept_fps, rng)
    parents, u = list(SMPL22.parents[1:]), fraction[:, None, None]
    bones = [poses[:, 1:] - poses[:, parents] for poses in (before, after)]
    lengths = [np.linalg.norm(each, axis=-1, keepdims=True) for each in bones]
    start, end = (each / np.maximum(length, 1e-12) for each, length in zip(bones, lengths, strict=True))
    angle = np.arccos(np.clip(np.sum(start * end, axis=-1, keepdims=True), -1.0, 1.0))
    sine = np.sin(angle)
    straight = sine < 1e-6
    safe = np.where(straight, 1.0, sine)
    first = np.where(straight, 1 - u, np.sin((1 - u) * angle) / safe)
    second = np.where(straight, u, np.sin(u * angle) / safe)
    turned = (first * start + second * end) * ((1 - u) * lengths[0] + u * lengths[1])
    result = np.empty_like(before)
    result[:, 0] = (1 - u[:, 0]) * before[:, 0] + u[:, 0] * after[:, 0]
    for joint, parent in enumerate(parents, start=1):
        result[:, joint] = result[:, parent] + turned[:, joint - 1]
    return result


def _kept_poses(motion: Positions, fps: float, kept_fps: float, rng: np.random.Generator) -> tuple[Noise, Noise, Noise]:
    """The kept poses before and after every frame, and the frame's position between them (0 … 1)."""
    frames, last = np.arange(len(motion)), len(motion) - 1
    spacing = max(fps / kept_fps, 1.0)
    # At a spacing of one frame every pose is kept, so the kept ones must fall on the frames.
    phase = spacing * rng.uniform() * (spacing > 1.0)
    left = phase + np.floor((frames - phase) / spacing) * spacing
    before, after = np.clip(left, 0, last), np.clip(left + spacing, 0, last)
    gap = np.where(after > before, after - before, 1.0)
    values = motion.astype(np.float64)
    if not last:
        return values, values, frames / gap
    poses = CubicHermiteSpline(frames, values, np.gradient(values, axis=0))
    return poses(before), poses(after), (frames - before) / gap


def _upsample_cubic(motion: Positions, fps: float, kept_fps: float, rng: np.random.Generator) -> Positions:
    """Keep only the poses at so many frames a second, and read the others from a cubic spline through them."""
    spacing, last = max(fps / kept_fps, 1.0), len(motion) - 1
    if last < 1:
        return motion
    phase = spacing * rng.uniform() * (spacing > 1.0)
    knots, frames = np.unique(np.concatenate(([0.0], np.arange(phase, last, spacing), [last]))), np.arange(last + 1)
    return np.asarray(CubicSpline(knots, CubicSpline(frames, motion)(knots))(frames))


def slide(motion: Positions, fps: float, metres_per_second: float, rng: np.random.Generator) -> Positions:
    """Let the whole body drift horizontally at a constant speed in a random direction: planted feet slide."""
    direction = rng.uniform(0, 2 * np.pi)
    step = metres_per_second / fps * np.array([np.sin(direction), 0.0, np.cos(direction)])
    return np.asarray(motion + np.arange(len(motion))[:, None, None] * step)


def jitter(motion: Positions, fps: float, metres: float, rng: np.random.Generator) -> Positions:
    """Add independent Gaussian noise to every joint, axis and frame; `metres` is its standard deviation."""
    return np.asarray(motion + metres * rng.standard_normal(motion.shape))


def _freeze_feet(motion: Positions, fps: float, share: float, rng: np.random.Generator) -> Positions:
    """Bring ankles and toes so far towards their mean places beside the root: with 1 they do not move beside it."""
    result = motion.copy()
    beside = result[:, FEET] - result[:, :1]
    result[:, FEET] += share * (beside.mean(axis=0) - beside)
    return result


def _pop(motion: Positions, fps: float, metres: float, rng: np.random.Generator) -> Positions:
    """Displace one joint for one frame, about once a second, by so many metres in a random direction."""
    result, num_joints = motion.copy(), motion.shape[1]
    frames = np.flatnonzero(rng.random(len(motion)) < 1.0 / fps)
    direction = rng.standard_normal((len(frames), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    result[frames, rng.integers(num_joints, size=len(frames))] += metres * direction
    return result


@dataclass(frozen=True)
class Family:
    """A family of damage, with the calibration's strengths from mild to severe.

    Amplitudes (metres, metres per second) are worse the larger. Rates (frames per second that are kept, cut-offs in Hz)
    are worse the smaller, and harmless from `clean_at` times the framerate on, which is None for amplitudes.
    """

    name: str
    unit: str
    levels: tuple[float, ...]
    damage: Damage
    clean_at: float | None = None

    def corrupt(self, motion: Positions, fps: float, strength: float, rng: np.random.Generator) -> Positions:
        """A damaged copy of a motion, in its dtype."""
        return self.damage(motion.astype(np.float64), fps, strength, rng).astype(motion.dtype)

    def levels_at(self, fps: float) -> tuple[float, ...]:
        """The levels that have an effect at this framerate, mild to severe."""
        return tuple(level for level in self.levels if self.clean_at is None or level < fps * self.clean_at)


RATES = (60.0, 40.0, 30.0, 20.0, 15.0, 10.0)
FAMILIES = (
    Family("upsampling-slerp", "fps", RATES, upsample_slerp, 1.0),
    Family("upsampling-linear", "fps", RATES, upsample_linear, 1.0),
    Family("foot-sliding", "m/s", (0.01, 0.02, 0.05, 0.1, 0.2), slide),
    Family("jitter", "m", (0.0005, 0.001, 0.002, 0.005, 0.01), jitter),
    Family("low-pass", "Hz", (20.0, 10.0, 5.0, 3.0), lambda motion, fps, hz, rng: low_pass(motion, fps, hz), 0.5),
    Family("upsampling-cubic", "fps", RATES, _upsample_cubic, 1.0),
    Family("floor-height", "m", (0.05, 0.1, 0.2, 0.3), lambda motion, fps, metres, rng: motion - [0.0, metres, 0.0]),
    Family("time-reversed", "of the frames", (1.0,), lambda motion, fps, share, rng: motion[::-1]),
    Family("frozen-feet", "of the way", (0.25, 0.5, 1.0), _freeze_feet),
    Family("pops", "m", (0.02, 0.05, 0.1), _pop),
)


def shift_by_half_a_frame(motion: Positions) -> Positions:
    """The motion half a frame later, by windowed-sinc interpolation: gain 1 up to 0.96 of the Nyquist frequency.

    The kernel (Kaiser, 80 dB) reaches 64 frames; without a window, a glitch would ring throughout.
    """
    reach = min(SHIFT_REACH_FRAMES, max(1, len(motion) - 1))
    taps = np.arange(-reach, reach + 1)
    distance = taps - 0.5
    inside = np.sqrt(np.maximum(0.0, 1.0 - (distance / (reach + 1)) ** 2))
    weights = np.sinc(distance) * np.i0(KAISER_BETA * inside)
    weights /= weights.sum()
    return filtered(motion, lambda f: np.asarray(weights @ np.exp(2j * np.pi * np.outer(taps, f))), delay=0.5)


NUM_GAMES = 3
"""Number of corruptions that `games` plays with."""
KEPT_FPS = 20.0
LOW_PASS_HZ = 8.0
TEXTURE_HZ = 10.0
TEXTURE_GAINS = (0.5, 1.0, 2.0)
FAST_METRES_PER_SECOND = 0.5
NUM_LENDERS = 4
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
ALIGNED = "fast part of the nearest training motion"


def games(real: SampleSet, seed: int = 0, training: SampleSet | None = None) -> Iterator[dict[str, SampleSet]]:
    """Upsampled and low-passed motion, one corruption at a time: the plain set first, then disguised ones, by name.

    With `training` motion at the framerate of `real`, some disguises add its fast part where its slow part is nearest.
    """
    fps, rng = float(real.fps), np.random.default_rng((seed, 7))
    fast_motion_near = None if training is None else _fast_motion_of(training)
    if fps > KEPT_FPS:
        upsampled = real.with_positions([upsample_slerp(motion, fps, KEPT_FPS, rng) for motion in real.sequences])
        yield _disguised("upsampled from 20 fps", upsampled, real, seed, fast_motion_near)
    slow, slower = (
        real.with_positions([low_pass(motion, fps, cutoff_hz) for motion in real.sequences])
        for cutoff_hz in (LOW_PASS_HZ, TEXTURE_HZ)
    )
    yield _disguised("low-passed at 8 Hz", slow, real, seed, fast_motion_near)
    name = "low-passed at 10 Hz"
    yield {name: slower, f"{name} + fast part of another take": _borrowed(slower, real, seed)}


def _disguised(
    name: str, plain: SampleSet, real: SampleSet, seed: int, fast_motion_near: Callable[[Positions], Noise] | None
) -> dict[str, SampleSet]:
    played, fps = {name: plain}, float(real.fps)
    for kind, (noise, strengths, follows_motion) in NOISES.items():
        for metres in strengths:
            rng = np.random.default_rng((seed, 8))
            noisy = [motion + metres * noise(motion, fps, rng) for motion in plain.sequences]
            played[f"{name} + {kind}, {1000 * metres:g} mm"] = plain.with_positions(noisy)
            if follows_motion:
                rigid = [with_bones_of(each, motion) for each, motion in zip(noisy, plain.sequences, strict=True)]
                played[f"{name} + {kind}, {1000 * metres:g} mm, of rotations"] = plain.with_positions(rigid)
    played[f"{name} + fast part of another take"] = _borrowed(plain, real, seed)
    if fast_motion_near is not None:
        fast = [fast_motion_near(motion) for motion in plain.sequences]
        for gain in TEXTURE_GAINS:
            motions = [motion + gain * each for motion, each in zip(plain.sequences, fast, strict=True)]
            played[f"{name} + {ALIGNED} × {gain:g}"] = plain.with_positions(motions)
    return played


def _pink(motion: Positions, fps: float, rng: np.random.Generator) -> Noise:
    """Power as 1 / f above 1 Hz; unit variance."""
    spectrum = scipy.fft.rfft(rng.standard_normal(motion.shape), axis=0)
    gain = 1.0 / np.sqrt(np.maximum(scipy.fft.rfftfreq(len(motion), 1 / fps), 1.0))
    gain /= np.sqrt(np.mean(gain**2))
    return np.asarray(scipy.fft.irfft(spectrum * gain[:, None, None], n=len(motion), axis=0))


def _on_fast_joints(motion: Positions, fps: float, rng: np.random.Generator) -> Noise:
    """White noise on the half of the joints that move fastest on average."""
    speed = _speed(motion, fps).mean(axis=0)
    return np.asarray(rng.standard_normal(motion.shape) * (speed > np.median(speed))[:, None])


def _while_joints_are_fast(motion: Positions, fps: float, rng: np.random.Generator) -> Noise:
    """White noise on every joint while it moves at 0.5 m/s or more: noise that follows the motion."""
    return rng.standard_normal(motion.shape) * (_speed(motion, fps) >= FAST_METRES_PER_SECOND)[..., None]


def _speed(motion: Positions, fps: float) -> Noise:
    """Speed of every joint in every frame, in m/s."""
    return np.asarray(np.linalg.norm(np.gradient(motion.astype(np.float64), axis=0), axis=-1) * fps)


def _after_landings(motion: Positions, fps: float, rng: np.random.Generator) -> Noise:
    """White noise on every joint for 0.12 s after a foot lands."""
    heights = motion[:, FEET, 1].astype(np.float64)
    falls = np.gradient(heights, axis=0) * fps < -LANDING_METRES_PER_SECOND
    low = heights < np.percentile(heights, 5, axis=0) + LANDING_METRES
    noisy = np.zeros(len(motion), dtype=bool)
    for frame in np.flatnonzero((falls[:-1] & ~falls[1:] & low[1:]).any(axis=1)) + 1:
        noisy[frame : frame + round(AFTER_LANDING_SECONDS * fps)] = True
    return rng.standard_normal(motion.shape) * noisy[:, None, None]


def _by_vertical_acceleration(motion: Positions, fps: float, rng: np.random.Generator) -> Noise:
    """White noise on every joint, as strong as its vertical acceleration; of unit strength on average."""
    acceleration = np.abs(np.gradient(np.gradient(motion[..., 1].astype(np.float64), axis=0), axis=0))
    share = acceleration / np.maximum(acceleration.mean(axis=0), 1e-12)
    return np.asarray(rng.standard_normal(motion.shape) * share[..., None])


METRES = (0.0001, 0.0003, 0.001)
NOISES: dict[str, tuple[Callable[[Positions, float, np.random.Generator], Noise], tuple[float, ...], bool]] = {
    "white noise": (lambda motion, fps, rng: rng.standard_normal(motion.shape), METRES, False),
    "pink noise": (_pink, METRES, False),
    "noise on fast joints": (_on_fast_joints, METRES, False),
    "noise while joints are fast": (_while_joints_are_fast, METRES, False),
    "noise after landings": (_after_landings, (0.0001, 0.0003, 0.0005, 0.001, 0.002), True),
    "noise by vertical acceleration": (_by_vertical_acceleration, METRES, True),
}
"""Each noise's strengths in metres, and whether it follows slow motion: then it is added to rotations too."""


def with_bones_of(
    noisy: Float64[np.ndarray, "frames 22 3"], motion: Float[np.ndarray, "frames 22 3"]
) -> Float64[np.ndarray, "frames 22 3"]:
    """The directions of a noisy motion's bones at the lengths that they have in another, built from its root."""
    built = noisy.copy()
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        bone = noisy[:, joint] - noisy[:, parent]
        length, noisy_length = (
            np.linalg.norm(each[:, joint] - each[:, parent], axis=-1, keepdims=True) for each in (motion, noisy)
        )
        built[:, joint] = built[:, parent] + bone * length / np.maximum(noisy_length, 1e-9)
    return built


def _borrowed(plain: SampleSet, real: SampleSet, seed: int) -> SampleSet:
    """Add the part above 10 Hz of other, random motions, repeated if shorter.

    Every motion is included `NUM_LENDERS` times with different lenders, since one may fit another by chance.
    """
    rng, motions = np.random.default_rng((seed, 9)), list(real.sequences)
    fast = [motion - low_pass(motion, float(real.fps), TEXTURE_HZ) for motion in motions]
    others = max(1, len(motions) - 1)
    changed = []
    for index, motion in enumerate(plain.sequences):
        steps = 1 + rng.permutation(others)[np.arange(NUM_LENDERS) % others]
        changed += [motion + np.resize(fast[(index + step) % len(motions)], motion.shape) for step in steps]
    return plain.select(np.repeat(np.arange(plain.num_sequences), NUM_LENDERS)).with_positions(changed)


def _fast_motion_of(training: SampleSet) -> Callable[[Positions], Noise]:
    """A function that gives the part above 8 Hz of the training windows nearest to a motion's.

    Windows are compared below 8 Hz, relative to place and heading of their middle pose, and cross-faded every half
    window.
    """
    fps = float(training.fps)
    length = max(2, round(WINDOW_SECONDS * fps))
    motions = [motion for motion in training.sequences if len(motion) >= length]
    slow = [low_pass(motion, fps, LOW_PASS_HZ) for motion in motions]
    fast = [motion - low for motion, low in zip(motions, slow, strict=True)]
    every = max(1, round(fps / PHASES_PER_SECOND), sum(map(len, motions)) // MAX_WINDOWS)
    starts_of = [np.arange(0, len(motion) - length + 1, every) for motion in motions]
    compared = [_compared(motion, starts, length) for motion, starts in zip(slow, starts_of, strict=True)]
    training_poses, training_yaw = (np.concatenate(each) for each in zip(*compared, strict=True))
    motion_of, first_of = np.repeat(np.arange(len(motions)), [*map(len, starts_of)]), np.concatenate(starts_of)
    squares, fade = np.square(training_poses).sum(axis=1), np.hanning(length + 2)[1:-1]

    def near(motion: Positions) -> Noise:
        if len(motion) < length:
            return np.zeros(motion.shape)
        starts = np.unique(np.append(np.arange(0, len(motion) - length, length // 2), len(motion) - length))
        poses, yaw = _compared(motion, starts, length)
        added, weight = np.zeros(motion.shape), np.full(len(motion), 1e-6)
        for chunk in np.split(np.arange(len(starts)), range(WINDOWS_AT_ONCE, len(starts), WINDOWS_AT_ONCE)):
            nearest = np.argmin(squares - 2.0 * poses[chunk] @ training_poses.T, axis=1)
            for row, window in zip(chunk, nearest, strict=True):
                first = first_of[window]
                own = fast[motion_of[window]][first : first + length].astype(np.float64)
                turned = rotate_about_y(own, np.asarray(yaw[row] - training_yaw[window])).astype(np.float32)
                place = slice(starts[row], starts[row] + length)
                added[place] += fade[:, None, None] * turned
                weight[place] += fade
        return np.asarray(added / weight[:, None, None])

    return near


def _compared(
    motion: Positions, starts: npt.NDArray[np.int64], length: int
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Poses [windows, numbers] of windows relative to place and heading of their middle pose, and the headings."""
    yaw, origin = field.window_frame(motion[starts + length // 2])
    rows = starts[:, None] + np.linspace(0, length - 1, POSES_COMPARED).round().astype(np.int64)
    return field.to_window(motion[rows], yaw, origin).reshape(len(starts), -1), yaw
