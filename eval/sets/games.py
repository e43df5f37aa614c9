"""Attempts to game a score: corrupted motion, with noise or the fast part of another take added.

A score that any of them lowers far below that of the plain corruption measures a capture's jitter.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from eval.sets.corruptions import low_pass, upsample_slerp
from eval.sets.sets import SampleSet

KEPT_FPS = 20.0
LOW_PASS_HZ = 8.0
TEXTURE_HZ = 10.0
NOISE_METRES = (0.0001, 0.0003, 0.001)
FAST_METRES_PER_SECOND = 0.5
NUM_LENDERS = 4
Take = npt.NDArray[np.float32]
Noise = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Games:
    """A plain corruption, and the same with cheats on top: sets of the same takes, by name."""

    parent: str
    honest: SampleSet
    cheats: dict[str, SampleSet]


def games(real: SampleSet, seed: int = 0) -> Iterator[Games]:
    """Upsampled and low-passed motion, each plain and disguised; one corruption at a time."""
    fps = float(real.fps)
    rng = np.random.default_rng((seed, 7))
    upsampled = _with(real, [upsample_slerp(take[None], fps, KEPT_FPS, rng)[0] for take in real.sequences])
    slow = _with(real, [low_pass(take[None], fps, LOW_PASS_HZ)[0] for take in real.sequences])
    slower = _with(real, [low_pass(take[None], fps, TEXTURE_HZ)[0] for take in real.sequences])
    if fps > KEPT_FPS:
        yield _games("upsampled from 20 fps", upsampled, real, seed)
    yield _games("low-passed at 8 Hz", slow, real, seed)
    name = "low-passed at 10 Hz"
    yield Games(name, slower, {f"{name} + fast part of another take": _borrowed(slower, real, seed)})


def _games(parent: str, honest: SampleSet, real: SampleSet, seed: int) -> Games:
    cheats = {}
    for kind, noise in NOISES.items():
        for metres in NOISE_METRES:
            rng = np.random.default_rng((seed, 8))
            noisy = [take + metres * noise(take, real, rng) for take in honest.sequences]
            cheats[f"{parent} + {kind}, {1000 * metres:g} mm"] = _with(honest, noisy)
    return Games(parent, honest, cheats | {f"{parent} + fast part of another take": _borrowed(honest, real, seed)})


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


NOISES: dict[str, Callable[[Take, SampleSet, np.random.Generator], Noise]] = {
    "white noise": _white,
    "pink noise": _pink,
    "noise on fast joints": _on_fast_joints,
    "noise while joints are fast": _while_joints_are_fast,
}


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


def _with(samples: SampleSet, takes: Sequence[npt.NDArray[np.floating]]) -> SampleSet:
    return samples.with_positions(samples.name, samples.fps, [take.astype(np.float32) for take in takes])
