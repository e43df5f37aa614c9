"""Per-pose channels of a motion, of which clip features are averages: slow motion, and power by frequency band.

Slow motion (below 6 Hz) is the body's movement; above 12 Hz are impacts and the capture's noise. Powers are those of
acceleration. Floors under their logarithms correspond to white noise of a fixed amplitude in the positions, so a floor
means the same at every framerate, and power below it counts for little.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.ndimage

from motionkit.core.shapes import Float, Float64

NUM_JOINTS = 22
JOINT_GROUPS: Mapping[str, tuple[int, ...]] = {
    "root": (0,),
    "legs": (1, 2, 4, 5),
    "feet": (7, 8, 10, 11),
    "hands": (18, 19, 20, 21),
    "upper": (3, 6, 9, 12, 13, 14, 15, 16, 17),
}
FEET = ((7, 10), (8, 11))

SLOW_HZ = 6.0
"""Poses and speeds are those of the motion below."""
LOW_EDGES = (0.0, 2.5, 5.0, 8.0)
MIDDLE_BAND = (8.0, 12.0)
HIGH_EDGES = (12.0, 18.0, 27.0, 40.0, 60.0)
FILTER_ORDER = 8

LOW_NOISE_METRES = 0.002
MIDDLE_NOISE_METRES = 0.004
HIGH_NOISE_METRES = 0.001
"""Floors of the bands: white noise of this standard deviation at 120 fps."""
NOISE_FPS = 120.0

ENVELOPE_SECONDS = 0.06
LOCAL_SECONDS = 1.0
LAG_SECONDS = 0.04
PAD_SECONDS = 1.0

SPEED_FLOOR = 0.03
FOOT_SPEED_FLOOR = 0.01
VELOCITY_SCALE, ACCELERATION_SCALE = 0.5, 10.0
"""Metres per second, and per second squared, at which signed predictors reach half of their limit."""
FOOT_JOINTS = tuple(joint for foot in FEET for joint in foot)
STEADY_JOINTS = (*FOOT_JOINTS, 0, 20, 21)

NUM_GROUPS = len(JOINT_GROUPS)
Band = tuple[float, float]
Signal = Float64[np.ndarray, "_frames _columns"]


def _group_means() -> Float64[np.ndarray, "coordinates groups"]:
    weights = np.zeros((NUM_JOINTS, len(JOINT_GROUPS)))
    for column, joints in enumerate(JOINT_GROUPS.values()):
        weights[list(joints), column] = 1.0 / len(joints)
    return np.repeat(weights, 3, axis=0)


GROUP_MEANS = _group_means()
"""Averages squared coordinates [66] over the joints of each group."""


@dataclass(frozen=True)
class Bands:
    """The frequency bands in Hz that a framerate can hold; the highest reaches its Nyquist frequency."""

    low: tuple[Band, ...]
    middle: tuple[Band, ...]
    high: tuple[Band, ...]

    @classmethod
    def at(cls, fps: Fraction) -> "Bands":
        """Bands of which at least half lies below the Nyquist frequency."""
        nyquist = float(fps) / 2
        edges = (*LOW_EDGES, *HIGH_EDGES)
        held = [(low, high) for low, high in pairwise(edges) if min(high, nyquist) - low >= (high - low) / 2]
        if held:
            held[-1] = (held[-1][0], max(nyquist, held[-1][0]))
        num_low = len(LOW_EDGES) - 1
        return cls(tuple(held[:num_low]), tuple(held[num_low : num_low + 1]), tuple(held[num_low + 1 :]))

    @property
    def all(self) -> tuple[Band, ...]:
        """From the lowest to the highest."""
        return (*self.low, *self.middle, *self.high)


def noise_power(bands: tuple[Band, ...], metres: float) -> Float64[np.ndarray, "bands"]:
    """Mean squared acceleration (m²/s⁴) in every band of white noise whose standard deviation at 120 fps is `metres`.

    It is that of one coordinate. Its density is metres² / 60 per Hz, of which acceleration has (2π f)⁴ times as much.
    """
    low, high = np.array(bands, dtype=np.float64).reshape(-1, 2).T
    power: Float64[np.ndarray, bands] = metres**2 / (NOISE_FPS / 2) * (2 * np.pi) ** 4 * (high**5 - low**5) / 5
    return power


@dataclass(frozen=True, eq=False)
class Channels:
    """One motion's numbers, a row for each pose; powers are in m²/s⁴, speeds in m/s, their logarithms natural.

    `steady` and `sudden` are what the timing of high power is predicted from: slow power and speeds of joint groups,
    then vertical motion of feet, root and hands; `timing` is the log power in every high band. All three are without
    their mean over a second.
    """

    pose: Float64[np.ndarray, "frames 63"]
    power: Float64[np.ndarray, "frames bands groups"]
    log_speed: Float64[np.ndarray, "frames groups"]
    log_foot_speed: Float64[np.ndarray, "frames 2"]
    steady: Float64[np.ndarray, "frames steady"]
    sudden: Float64[np.ndarray, "frames sudden"]
    timing: Float64[np.ndarray, "frames timing"]


def channels(positions: Float[np.ndarray, "frames joints 3"], fps: Fraction) -> Channels:
    """Channels of one motion of the 22 joints of `SMPL22`, in metres, y up."""
    if positions.shape[1] != NUM_JOINTS:
        raise ValueError(f"motions have {positions.shape[1]} joints; the descriptor is defined on {NUM_JOINTS}")
    rate, bands = float(fps), Bands.at(fps)
    spectrum = _Spectrum.of(positions.reshape(len(positions), -1).astype(np.float64), rate)
    slow = spectrum.below(SLOW_HZ)
    power = np.stack([np.square(spectrum.acceleration(band)) @ GROUP_MEANS for band in bands.all], axis=1)
    velocity = _rate_of_change(slow.reshape(positions.shape), rate)
    acceleration = _rate_of_change(velocity, rate)
    speed = np.log(np.linalg.norm(velocity, axis=-1) + SPEED_FLOOR)
    group_speed = speed @ GROUP_MEANS[::3]
    envelopes = smoothed(power.reshape(len(power), -1), ENVELOPE_SECONDS, rate).reshape(power.shape)
    num_slow = 2
    slow_power = np.log(envelopes[:, :num_slow] + noise_power(bands.low[:num_slow], LOW_NOISE_METRES)[:, None])
    high = envelopes[:, len(bands.all) - len(bands.high) :]
    timing = np.log(high + noise_power(bands.high, HIGH_NOISE_METRES)[:, None]).reshape(len(power), -1)
    sudden = (
        speed[:, FOOT_JOINTS],
        np.arctan(velocity[:, FOOT_JOINTS, 1] / VELOCITY_SCALE),
        np.arctan(acceleration[:, STEADY_JOINTS, 1] / ACCELERATION_SCALE),
    )
    return Channels(
        pose=local_poses(slow.reshape(1, *positions.shape))[0],
        power=power,
        log_speed=group_speed,
        log_foot_speed=_log_foot_speed(velocity),
        steady=_lagged(np.concatenate((slow_power.reshape(len(power), -1), group_speed), axis=1), rate),
        sudden=_lagged(np.concatenate(sudden, axis=1), rate),
        timing=_deviation(timing, rate),
    )


@dataclass(frozen=True, eq=False)
class _Spectrum:
    """The Fourier transform of a motion extended at both ends, and its linear trend."""

    values: npt.NDArray[np.complex128]
    frequencies_hz: npt.NDArray[np.float64]
    trend: Signal
    pad: int
    rate: float

    @classmethod
    def of(cls, signal: Signal, rate: float) -> "_Spectrum":
        """Extend the ends by point reflection, which keeps their velocity."""
        pad = min(len(signal) - 1, round(PAD_SECONDS * rate))
        before, after = 2 * signal[:1] - signal[pad:0:-1], 2 * signal[-1:] - signal[-2 : -2 - pad : -1]
        whole = np.concatenate((before, signal, after))
        slope = (whole[-1] - whole[0]) / max(1, len(whole) - 1)
        trend = whole[:1] + np.arange(len(whole))[:, None] * slope
        values = scipy.fft.rfft(whole - trend, axis=0)
        return cls(values, scipy.fft.rfftfreq(len(whole), 1 / rate), trend, pad, rate)

    def below(self, cutoff_hz: float) -> Signal:
        """Zero-phase low-pass."""
        signal: Signal = self._inverse(_low_gain(self.frequencies_hz, cutoff_hz)) + self._own(self.trend)
        return signal

    def acceleration(self, band: Band) -> Signal:
        """Second difference per second squared, of one band alone."""
        low, high = band
        gain = 1.0 - _low_gain(self.frequencies_hz, low)
        if high < self.rate / 2:
            gain = _low_gain(self.frequencies_hz, high) - _low_gain(self.frequencies_hz, low)
        return self._inverse(gain * np.square(2 * self.rate * np.sin(np.pi * self.frequencies_hz / self.rate)))

    def _inverse(self, gain: npt.NDArray[np.float64]) -> Signal:
        signal: Signal = scipy.fft.irfft(self.values * gain[:, None], n=len(self.trend), axis=0)
        return self._own(signal)

    def _own(self, continued: Signal) -> Signal:
        own: Signal = continued[self.pad : len(continued) - self.pad]
        return own


def _low_gain(frequencies_hz: npt.NDArray[np.float64], cutoff_hz: float) -> npt.NDArray[np.float64]:
    """Squared Butterworth gain: a filter forwards and backwards; 0 for a cut-off of 0."""
    if cutoff_hz == 0:
        return np.zeros_like(frequencies_hz)
    gain: npt.NDArray[np.float64] = 1.0 / (1.0 + (frequencies_hz / cutoff_hz) ** (2 * FILTER_ORDER))
    return gain


def smoothed(values: Signal, seconds: float, rate: float) -> Signal:
    """Means over a Hann window of about so many seconds, an odd number of frames, reflected at the ends."""
    num = min(max(1, round(seconds * rate)) | 1, (len(values) - 1) | 1)
    if num < 3:
        return values
    window = np.hanning(num + 2)[1:-1]
    mean: Signal = scipy.ndimage.convolve1d(values, window / window.sum(), axis=0, mode="reflect")
    return mean


def _deviation(values: Signal, rate: float) -> Signal:
    deviation: Signal = values - smoothed(values, LOCAL_SECONDS, rate)
    return deviation


def _lagged(values: Signal, rate: float) -> Signal:
    """Deviations from the local mean, now, 40 ms later and 40 ms earlier, side by side."""
    lag = max(1, round(LAG_SECONDS * rate))
    deviation = _deviation(values, rate)
    padded = np.pad(deviation, ((lag, lag), (0, 0)), mode="edge")
    return np.concatenate((deviation, padded[2 * lag :], padded[: -2 * lag]), axis=1)


def _rate_of_change(values: npt.NDArray[np.float64], rate: float) -> npt.NDArray[np.float64]:
    """Central differences per second, one-sided at the ends; 0 for a single frame."""
    if len(values) < 2:
        return np.zeros_like(values)
    change: npt.NDArray[np.float64] = np.gradient(values, axis=0) * rate
    return change


def _log_foot_speed(velocity: Float64[np.ndarray, "frames joints 3"]) -> Float64[np.ndarray, "frames 2"]:
    """Log horizontal speed of the slower foot, then of the other; a foot's speed is that of its slower joint."""
    speed = np.linalg.norm(velocity[..., [0, 2]], axis=-1)
    feet = np.sort(np.stack([speed[:, list(foot)].min(axis=-1) for foot in FEET], axis=-1), axis=-1)
    log_speed: Float64[np.ndarray, "frames 2"] = np.log(feet + FOOT_SPEED_FLOOR)
    return log_speed


def local_poses(positions: Float64[np.ndarray, "clips poses joints 3"]) -> Float64[np.ndarray, "clips poses 63"]:
    """Joints 1 … 21 relative to the root, rotated so that hips and shoulders face +Z at every instant."""
    across = positions[:, :, 2] - positions[:, :, 1] + positions[:, :, 17] - positions[:, :, 16]
    length = np.hypot(across[..., 0], across[..., 2])
    safe = np.where(length > 0, length, 1.0)[..., None]
    x, z = across[..., :1] / safe, across[..., 2:] / safe
    relative = positions[:, :, 1:] - positions[:, :, :1]
    local: Float64[np.ndarray, "clips poses joints 3"] = np.empty_like(relative)
    local[..., 0] = -(relative[..., 0] * x + relative[..., 2] * z)
    local[..., 1] = relative[..., 1]
    local[..., 2] = relative[..., 0] * z - relative[..., 2] * x
    return local.reshape(len(positions), -1, 63)
