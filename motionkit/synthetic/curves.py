"""Smooth functions of time: ramps, pulses, glides and band-limited noise. All are defined at every instant."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

Curve = Callable[[Float64[np.ndarray, " times"]], Float64[np.ndarray, " times"]]


def smoothstep(u: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    """0 below u = 0, 1 above u = 1, and between them the quintic whose first two derivatives vanish at both ends."""
    x = np.clip(u, 0.0, 1.0)
    value: Float64[np.ndarray, "*shape"] = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    return value


def glide(u: Float64[np.ndarray, "*shape"], ramp: float = 0.35) -> Float64[np.ndarray, "*shape"]:
    """0 below u = 0, 1 above u = 1, between them at constant speed but for smooth ramps of length `ramp`.

    Its highest speed is 1 / (1 − ramp), where `smoothstep` has 1.875: a swinging foot moves like this.
    """

    def eased(x: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
        y = np.clip(x / ramp, 0.0, 1.0)
        travelled: Float64[np.ndarray, "*shape"] = ramp * (y**3 - y**4 / 2.0) + np.maximum(x - ramp, 0.0)
        return travelled

    x = np.clip(u, 0.0, 1.0)
    return np.asarray(np.where(x < 0.5, eased(x), (1.0 - ramp) - eased(1.0 - x)) / (1.0 - ramp))


@dataclass(frozen=True)
class Pulse:
    """Rises from 0 at `start` for `rise` seconds, holds `height` for `hold`, falls to 0 within `fall`."""

    start: float
    rise: float
    hold: float
    fall: float
    height: float = 1.0

    def __call__(self, t: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, " times"]:
        """The pulse at times in seconds."""
        up = smoothstep((t - self.start) / self.rise)
        down = smoothstep((t - (self.start + self.rise + self.hold)) / self.fall)
        return np.asarray(self.height * (up - down))


@dataclass(frozen=True)
class Constant:
    """The same value at every instant."""

    value: float

    def __call__(self, t: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, " times"]:
        """The value at times in seconds."""
        return np.full(t.shape, self.value)


@dataclass(frozen=True)
class Wave:
    """height · sin 2πf(t − zero_seconds)."""

    frequency_hertz: float
    zero_seconds: float = 0.0
    height: float = 1.0

    def __call__(self, t: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, " times"]:
        """The wave at times in seconds."""
        return np.asarray(self.height * np.sin(2.0 * np.pi * self.frequency_hertz * (t - self.zero_seconds)))


@dataclass(frozen=True)
class Product:
    """The product of curves."""

    factors: tuple[Curve, ...]

    def __call__(self, t: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, " times"]:
        """The product at times in seconds."""
        value = np.ones(t.shape)
        for factor in self.factors:
            value = value * factor(t)
        return value


@dataclass(frozen=True)
class Total:
    """The sum of curves."""

    terms: tuple[Curve, ...]

    def __call__(self, t: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, " times"]:
        """The sum at times in seconds."""
        value = np.zeros(t.shape)
        for term in self.terms:
            value = value + term(t)
        return value


@dataclass(frozen=True)
class Shock:
    """A damped oscillation that begins at `start`: what a heel strike sends up the body."""

    start: float
    height: float
    frequency_hertz: float = 17.0
    decay_seconds: float = 0.05

    def __call__(self, t: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, " times"]:
        """The oscillation at times in seconds."""
        since = np.maximum(t - self.start, 0.0)
        fading = smoothstep(since * self.frequency_hertz) * np.exp(-since / self.decay_seconds)
        return np.asarray(self.height * fading * np.sin(2.0 * np.pi * self.frequency_hertz * since))


@dataclass(frozen=True, eq=False)
class BandNoise:
    """A sum of sinusoids: smooth, band-limited, defined at every instant. Amplitudes, hertz and radians, each [M]."""

    amplitudes: Float64[np.ndarray, " waves"]
    frequencies: Float64[np.ndarray, " waves"]
    phases: Float64[np.ndarray, " waves"]

    def __call__(self, t: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, " times"]:
        """The noise at times in seconds."""
        return np.asarray(np.sin(2.0 * np.pi * np.outer(t, self.frequencies) + self.phases) @ self.amplitudes)


def band_noise(
    rng: np.random.Generator, standard_deviation: float, lowest_hertz: float, highest_hertz: float, num_waves: int = 8
) -> BandNoise:
    """Noise of a given standard deviation whose frequencies are log-uniform in a band, amplitudes falling as 1/f."""
    frequencies = np.exp(rng.uniform(np.log(lowest_hertz), np.log(highest_hertz), num_waves))
    weights = rng.uniform(0.5, 1.5, num_waves) / frequencies
    amplitudes = weights * standard_deviation * np.sqrt(2.0 / np.sum(weights**2))
    return BandNoise(amplitudes, frequencies, rng.uniform(0.0, 2.0 * np.pi, num_waves))


def cosine(frequency_hertz: float, peak_seconds: float = 0.0, height: float = 1.0) -> Wave:
    """height · cos 2πf(t − peak_seconds)."""
    return Wave(frequency_hertz, peak_seconds - 0.25 / frequency_hertz, height)


def product(*curves: Curve) -> Product:
    """The product of curves."""
    return Product(curves)


def total(*curves: Curve) -> Total:
    """The sum of curves."""
    return Total(curves)


def scaled(factor: float, curve: Curve) -> Product:
    """factor · curve."""
    return Product((Constant(factor), curve))
