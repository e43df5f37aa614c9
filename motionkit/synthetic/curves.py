"""Smooth functions of time: ramps, pulses, glides and band-limited noise. All are defined at every instant."""

from collections.abc import Callable
from functools import partial, reduce

import numpy as np
from jaxtyping import Float64

Curve = Callable[[Float64[np.ndarray, " times"]], Float64[np.ndarray, " times"]]

SHOCK_DECAY_SECONDS = 0.05
NOISE_WAVES = 8


def smoothstep(u: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    """0 below u = 0, 1 above u = 1, and between them the quintic whose first two derivatives vanish at both ends."""
    x = np.clip(u, 0.0, 1.0)
    value: Float64[np.ndarray, "*shape"] = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    return value


def glide(u: Float64[np.ndarray, "*shape"], ramp: float = 0.35) -> Float64[np.ndarray, "*shape"]:
    """0 below u = 0, 1 above u = 1, at constant speed between them except for smooth ramps of length `ramp`.

    Its maximum speed is 1 / (1 − ramp), against 1.875 for `smoothstep`; used for swinging feet.
    """
    x = np.clip(u, 0.0, 1.0)
    return np.asarray(np.where(x < 0.5, _eased(x, ramp), (1.0 - ramp) - _eased(1.0 - x, ramp)) / (1.0 - ramp))


def _eased(x: Float64[np.ndarray, "*shape"], ramp: float) -> Float64[np.ndarray, "*shape"]:
    y = np.clip(x / ramp, 0.0, 1.0)
    travelled: Float64[np.ndarray, "*shape"] = ramp * (y**3 - y**4 / 2.0) + np.maximum(x - ramp, 0.0)
    return travelled


def pulse(start: float, rise: float, hold: float, fall: float, height: float = 1.0) -> Curve:
    """Rises from 0 at `start` for `rise` seconds, holds `height` for `hold`, falls to 0 within `fall`."""
    return partial(_pulse_at, start=start, rise=rise, end=start + rise + hold, fall=fall, height=height)


def _pulse_at(
    t: Float64[np.ndarray, " times"], start: float, rise: float, end: float, fall: float, height: float
) -> Float64[np.ndarray, " times"]:
    return np.asarray(height * (smoothstep((t - start) / rise) - smoothstep((t - end) / fall)))


def constant(value: float) -> Curve:
    """The same value at every instant."""
    return lambda t: np.full(t.shape, value)


def wave(frequency_hertz: float, zero_seconds: float = 0.0, height: float = 1.0) -> Curve:
    """height · sin 2πf(t − zero_seconds)."""
    return lambda t: np.asarray(height * np.sin(2.0 * np.pi * frequency_hertz * (t - zero_seconds)))


def cosine(frequency_hertz: float, peak_seconds: float = 0.0, height: float = 1.0) -> Curve:
    """height · cos 2πf(t − peak_seconds)."""
    return wave(frequency_hertz, peak_seconds - 0.25 / frequency_hertz, height)


def product(*curves: Curve) -> Curve:
    """The product of curves."""
    return lambda t: reduce(np.multiply, (curve(t) for curve in curves), np.ones(t.shape))


def total(*curves: Curve) -> Curve:
    """The sum of curves."""
    return lambda t: reduce(np.add, (curve(t) for curve in curves), np.zeros(t.shape))


def scaled(factor: float, curve: Curve) -> Curve:
    """factor · curve."""
    return product(constant(factor), curve)


def shock(start: float, height: float, frequency_hertz: float = 17.0) -> Curve:
    """A damped oscillation that begins at `start`, as after a heel strike."""
    return partial(_shock_at, start=start, height=height, frequency_hertz=frequency_hertz)


def _shock_at(
    t: Float64[np.ndarray, " times"], start: float, height: float, frequency_hertz: float
) -> Float64[np.ndarray, " times"]:
    since = np.maximum(t - start, 0.0)
    fading = smoothstep(since * frequency_hertz) * np.exp(-since / SHOCK_DECAY_SECONDS)
    return np.asarray(height * fading * np.sin(2.0 * np.pi * frequency_hertz * since))


def band_noise(rng: np.random.Generator, standard_deviation: float, lowest_hertz: float, highest_hertz: float) -> Curve:
    """Noise, a sum of sinusoids: frequencies are log-uniform in a band, amplitudes fall as 1/f."""
    frequencies = np.exp(rng.uniform(np.log(lowest_hertz), np.log(highest_hertz), NOISE_WAVES))
    weights = rng.uniform(0.5, 1.5, NOISE_WAVES) / frequencies
    amplitudes = weights * standard_deviation * np.sqrt(2.0 / np.sum(weights**2))
    phases = rng.uniform(0.0, 2.0 * np.pi, NOISE_WAVES)
    return lambda t: np.asarray(np.sin(2.0 * np.pi * np.outer(t, frequencies) + phases) @ amplitudes)
