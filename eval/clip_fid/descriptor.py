"""The kinematic descriptor, version 3: what bodies do below 8 Hz, by its distribution.

Poses and their spread, power in three slow bands, speeds, sliding feet, height above the floor, and the direction of
time. Nothing above 8 Hz: a sum that sees fast motion is won by adding noise, and one that does not see it is blind. So
fast motion has figures of its own (`eval.detail`; docs/results/games.md).

Powers are those of acceleration. Floors under their logarithms correspond to white noise of a fixed amplitude in the
positions, so a floor means the same at every framerate, and power below it counts for little.
"""

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import scipy.fft
from threadpoolctl import threadpool_limits

from eval.sets.sets import Ragged, SampleSet
from motionkit.core.shapes import Float, Float32, Float64

VERSION = "kinematic/3"

NUM_JOINTS = 22
JOINT_GROUPS: Mapping[str, tuple[int, ...]] = {
    "root": (0,),
    "legs": (1, 2, 4, 5),
    "feet": (7, 8, 10, 11),
    "hands": (18, 19, 20, 21),
    "upper": (3, 6, 9, 12, 13, 14, 15, 16, 17),
}
FEET = ((7, 10), (8, 11))
FOOT_JOINTS = tuple(joint for foot in FEET for joint in foot)

SLOW_HZ = 8.0
"""Poses and speeds are those of the motion below."""
SLOW_BANDS = ((0.0, 2.5), (2.5, 5.0), (5.0, 8.0))
"""Frequency bands of slow power, Hz; every framerate from 20 fps holds them."""
FILTER_ORDER = 8

SLOW_NOISE_METRES = (0.002, 0.002, 0.004)
"""Floors of the slow bands: white noise of this standard deviation at 120 fps."""
NOISE_FPS = 120.0
PAD_SECONDS = 1.0

SPEED_FLOOR = 0.03
FOOT_SPEED_FLOOR = 0.01
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


def noise_power(bands: tuple[Band, ...], metres: float) -> Float64[np.ndarray, "bands"]:
    """Mean squared acceleration (m²/s⁴) in every band of white noise whose standard deviation at 120 fps is `metres`.

    It is that of one coordinate. Its density is metres² / 60 per Hz, of which acceleration has (2π f)⁴ times as much.
    """
    low, high = np.array(bands, dtype=np.float64).reshape(-1, 2).T
    power: Float64[np.ndarray, bands] = metres**2 / (NOISE_FPS / 2) * (2 * np.pi) ** 4 * (high**5 - low**5) / 5
    return power


@dataclass(frozen=True, eq=False)
class Channels:
    """One motion below 8 Hz, a row for each pose; powers are in m²/s⁴, speeds in m/s, their logarithms natural.

    `height` is that of the lower foot in metres; `direction` are odd functions of velocity, which tell forwards from
    backwards.
    """

    pose: Float64[np.ndarray, "frames 63"]
    power: Float64[np.ndarray, "frames bands groups"]
    log_speed: Float64[np.ndarray, "frames groups"]
    log_foot_speed: Float64[np.ndarray, "frames 2"]
    height: Float64[np.ndarray, "frames 1"]
    direction: Float64[np.ndarray, "frames direction"]


def channels(positions: Float[np.ndarray, "frames joints 3"], fps: Fraction) -> Channels:
    """Channels of one motion of the 22 joints of `SMPL22`, in metres, y up."""
    if positions.shape[1] != NUM_JOINTS:
        raise ValueError(f"motions have {positions.shape[1]} joints; the descriptor is defined on {NUM_JOINTS}")
    rate = float(fps)
    spectrum = Spectrum.of(positions.reshape(len(positions), -1).astype(np.float64), rate)
    slow = spectrum.below(SLOW_HZ).reshape(positions.shape)
    velocity = rate_of_change(slow, rate)
    speed = np.log(np.linalg.norm(velocity, axis=-1) + SPEED_FLOOR)
    return Channels(
        pose=local_poses(slow[None])[0],
        power=np.stack([np.square(spectrum.acceleration(band)) @ GROUP_MEANS for band in SLOW_BANDS], axis=1),
        log_speed=speed @ GROUP_MEANS[::3],
        log_foot_speed=_log_foot_speed(velocity),
        height=slow[:, FOOT_JOINTS, 1].min(axis=1, keepdims=True),
        direction=_direction(slow, velocity),
    )


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The Fourier transform of a motion extended at both ends, in single precision, and its linear trend."""

    values: npt.NDArray[np.complex64]
    frequencies_hz: npt.NDArray[np.float64]
    trend: Signal
    pad: int
    rate: float

    @classmethod
    def of(cls, signal: Signal, rate: float) -> "Spectrum":
        """Extend the ends by point reflection, which keeps their velocity."""
        pad = min(len(signal) - 1, round(PAD_SECONDS * rate))
        before, after = 2 * signal[:1] - signal[pad:0:-1], 2 * signal[-1:] - signal[-2 : -2 - pad : -1]
        whole = np.concatenate((before, signal, after))
        slope = (whole[-1] - whole[0]) / max(1, len(whole) - 1)
        trend = whole[:1] + np.arange(len(whole))[:, None] * slope
        values = scipy.fft.rfft((whole - trend).astype(np.float32), axis=0)
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
        filtered = self.values * gain.astype(np.float32)[:, None]
        return self._own(scipy.fft.irfft(filtered, n=len(self.trend), axis=0).astype(np.float64))

    def _own(self, continued: Signal) -> Signal:
        own: Signal = continued[self.pad : len(continued) - self.pad]
        return own


def _low_gain(frequencies_hz: npt.NDArray[np.float64], cutoff_hz: float) -> npt.NDArray[np.float64]:
    """Squared Butterworth gain: a filter forwards and backwards; 0 for a cut-off of 0."""
    if cutoff_hz == 0:
        return np.zeros_like(frequencies_hz)
    gain: npt.NDArray[np.float64] = 1.0 / (1.0 + (frequencies_hz / cutoff_hz) ** (2 * FILTER_ORDER))
    return gain


def rate_of_change(values: npt.NDArray[np.float64], rate: float) -> npt.NDArray[np.float64]:
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


def _direction(
    slow: Float64[np.ndarray, "frames joints 3"], velocity: Float64[np.ndarray, "frames joints 3"]
) -> Float64[np.ndarray, "frames direction"]:
    """Odd functions of velocity, whose means change sign when time runs backwards.

    First the root's speed forwards in m/s, then the cube root of vertical speed by joint group: where falling is faster
    than rising, it takes less time, and the mean is positive.
    """
    right_x, right_z = _to_the_right(slow)
    forwards = velocity[:, 0, 0] * right_z - velocity[:, 0, 2] * right_x
    return np.concatenate((forwards[:, None], np.cbrt(velocity[..., 1] @ GROUP_MEANS[::3])), axis=1)


def _to_the_right(
    positions: Float64[np.ndarray, "*batch joints 3"],
) -> tuple[Float64[np.ndarray, "*batch"], Float64[np.ndarray, "*batch"]]:
    """x and z of the horizontal unit vector from the left hip and shoulder to the right ones; 0 where there is none."""
    across = positions[..., 2, :] - positions[..., 1, :] + positions[..., 17, :] - positions[..., 16, :]
    length = np.hypot(across[..., 0], across[..., 2])
    safe = np.where(length > 0, length, 1.0)
    return across[..., 0] / safe, across[..., 2] / safe


def local_poses(positions: Float64[np.ndarray, "clips poses joints 3"]) -> Float64[np.ndarray, "clips poses 63"]:
    """Joints 1 … 21 relative to the root, rotated so that hips and shoulders face +Z at every instant."""
    x, z = (each[..., None] for each in _to_the_right(positions))
    relative = positions[:, :, 1:] - positions[:, :, :1]
    local: Float64[np.ndarray, "clips poses joints 3"] = np.empty_like(relative)
    local[..., 0] = -(relative[..., 0] * x + relative[..., 2] * z)
    local[..., 1] = relative[..., 1]
    local[..., 2] = relative[..., 0] * z - relative[..., 2] * x
    return local.reshape(len(positions), -1, 63)


NUM_POSE_COMPONENTS = 10

SIZES: Mapping[str, int] = {
    "pose": NUM_POSE_COMPONENTS,
    "spread": NUM_POSE_COMPONENTS,
    "slow": 2 * NUM_GROUPS,
    "upper slow": NUM_GROUPS,
    "speed": NUM_GROUPS,
    "slip": 2,
    "height": 1,
    "direction": 1 + NUM_GROUPS,
}
"""Number of features of each block, in order."""
# Weights were chosen on training takes alone (docs/metrics.md): every block's total variance on real training clips.
WEIGHTS: Mapping[str, float] = {
    "pose": 1.0,
    "spread": 1.0,
    "slow": 5.5,
    "upper slow": 0.45,
    "speed": 1.0,
    "slip": 1.3,
    "height": 1.0,
    "direction": 1.0,
}

SPREAD_FLOOR_METRES = 0.005
LEAST_LOG_SPREAD = 0.25
LEAST_POSE_SPREAD = 0.02
LEAST_SPREADS: Mapping[str, float] = {"pose": LEAST_POSE_SPREAD, "height": LEAST_POSE_SPREAD, "direction": 0.1}
"""Minimum standard deviations for the standardisation: metres, metres per second; `LEAST_LOG_SPREAD` for logarithms."""


def _blocks() -> dict[str, slice]:
    stops = np.cumsum(list(SIZES.values())).tolist()
    return {name: slice(stop - size, stop) for (name, size), stop in zip(SIZES.items(), stops, strict=True)}


BLOCKS: Mapping[str, slice] = _blocks()
NUM_FEATURES = sum(SIZES.values())


@dataclass(frozen=True, eq=False)
class KinematicDescriptor:
    """The descriptor fitted at one framerate.

    `pose_mean` [63] and `pose_components` [10, 63] span poses relative to root and heading; `centre` and `scale`
    standardise the features, and weigh them.
    """

    fps: Fraction
    pose_mean: Float64[np.ndarray, "coordinates"]
    pose_components: Float64[np.ndarray, "components coordinates"]
    centre: Float64[np.ndarray, "features"]
    scale: Float64[np.ndarray, "features"]

    @property
    def name(self) -> str:
        """Name for tables."""
        return "kinematic"

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over version, framerate and every fitted number."""
        digest = hashlib.sha256(f"{VERSION} {self.fps}".encode())
        for array in (self.pose_mean, self.pose_components, self.centre, self.scale):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()[:16]

    def frames(self, samples: SampleSet) -> Ragged:
        """A row for every pose of the motions, of which clips are averages: [rows, numbers], float32."""
        if samples.fps != self.fps:
            raise ValueError(f"this descriptor was fitted at {self.fps} fps; {samples.name} is at {samples.fps} fps")
        return Ragged.of(list(in_threads(lambda motion: self.rows(channels(motion, self.fps)), samples.sequences)))

    def rows(self, motion: Channels) -> Float32[np.ndarray, "frames numbers"]:
        """A row for every pose of a motion, of which clips are averages."""
        scores = (motion.pose - self.pose_mean) @ self.pose_components.T
        power = motion.power.reshape(len(scores), -1)
        averaged = (motion.log_speed, motion.log_foot_speed, motion.height, motion.direction)
        return np.concatenate((scores, np.square(scores), power, *averaged), axis=1, dtype=np.float32)

    def describe(
        self, clips: Float[np.ndarray, "clips poses numbers"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """Features of clips of the output of `frames`. Raises `ValueError` for another framerate."""
        if fps != self.fps:
            raise ValueError(f"this descriptor was fitted at {self.fps} fps; clips at {fps} fps need one of their own")
        described: Float64[np.ndarray, "clips features"] = (_raw_features(clips) - self.centre) * self.scale
        return described


def fit_kinematic(motions: Sequence[Channels], fps: Fraction) -> KinematicDescriptor:
    """Fit the components on real training motions at one framerate; `standardised` does the rest.

    A component's sign is fixed by its largest coordinate, so that the fit does not depend on the linear algebra
    library. Raises `ValueError` for no motion.
    """
    if not motions:
        raise ValueError("fitting the kinematic descriptor needs at least one motion")
    poses = np.concatenate([motion.pose for motion in motions])
    pose_mean = poses.mean(axis=0)
    _, eigenvectors = np.linalg.eigh((poses - pose_mean).T @ (poses - pose_mean) / len(poses))
    components = eigenvectors.T[::-1][:NUM_POSE_COMPONENTS]
    largest = np.take_along_axis(components, np.abs(components).argmax(axis=1)[:, None], axis=1)
    signed = np.ascontiguousarray(components * np.sign(largest))
    return KinematicDescriptor(fps, pose_mean, signed, np.zeros(NUM_FEATURES), np.ones(NUM_FEATURES))


def standardised(fitted: KinematicDescriptor, described: Float64[np.ndarray, "clips features"]) -> KinematicDescriptor:
    """The descriptor with centre and weights measured on training clips, which `fitted` has described."""
    spread, scale = described.std(axis=0), np.empty(NUM_FEATURES)
    for name, block in BLOCKS.items():
        least = LEAST_SPREADS.get(name, LEAST_LOG_SPREAD)
        scale[block] = np.sqrt(WEIGHTS[name] / SIZES[name]) / np.maximum(spread[block], least)
    return replace(fitted, centre=described.mean(axis=0), scale=scale)


def _raw_features(clips: Float[np.ndarray, "clips poses numbers"]) -> Float64[np.ndarray, "clips features"]:
    """Means over the clip, those of powers as logarithms above their floors, before standardisation."""
    means = clips.mean(axis=1, dtype=np.float64)
    sizes = np.cumsum((NUM_POSE_COMPONENTS, NUM_POSE_COMPONENTS, NUM_GROUPS * len(SLOW_BANDS)))
    pose, squares, power, others = np.split(means, sizes, axis=1)
    spread = 0.5 * np.log(np.maximum(squares - np.square(pose), 0.0) + SPREAD_FLOOR_METRES**2)
    floors = np.concatenate(
        [noise_power((band,), metres) for band, metres in zip(SLOW_BANDS, SLOW_NOISE_METRES, strict=True)]
    )
    log_power = 0.5 * np.log(np.maximum(power, 0.0) + np.repeat(floors, NUM_GROUPS))
    return np.concatenate((pose, spread, log_power, others), axis=1)


Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """The results of a function of each item, in order; numpy releases the GIL.

    BLAS gets one thread in each, to avoid oversubscription.
    """
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        yield from pool.map(function, items)
