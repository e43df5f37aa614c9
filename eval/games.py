"""Games: attempts to hide from clip-FID and the detail profile that motion was upsampled or low-passed.

Each adds something to the plain corruption: noise, at any time or at the right one, to positions or to rotations, or
the fast motion of other takes. A game is won if no figure sees it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from eval.sets.corruptions import low_pass, turn, upsample_slerp
from eval.sets.sets import SampleSet
from motionkit.core.shapes import Float, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.features import field

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
    slow = _with(real, [low_pass(take[None], fps, LOW_PASS_HZ)[0] for take in real.sequences])
    slower = _with(real, [low_pass(take[None], fps, TEXTURE_HZ)[0] for take in real.sequences])
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
    fast = [take - low_pass(take[None], float(real.fps), TEXTURE_HZ)[0] for take in takes]
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
    slow = [low_pass(take[None], fps, LOW_PASS_HZ)[0] for take in takes]
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
