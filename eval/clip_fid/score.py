"""clip-FID as this project defines it: a distance between features of random native-rate clips.

The NeRM paper (§4.2) compares random clips of m poses at framerate s around a centre v, real against generated, without
resampling either. m, the number of clips, the extractor and the real set are this project's choices; `VERSION` is
raised whenever one of them changes. Not the FID of images on CLIP features that other tools call clip-FID.

The kinematic descriptor describes what bodies do below 8 Hz: poses and their spread, power in three slow bands, speeds,
sliding feet, height above the floor, and the direction of time. Faster motion has figures of its own (`eval.detail`): a
sum that includes it is won by adding noise (docs/results/games.md). Powers are those of acceleration; floors under
their logarithms are white noise of a fixed amplitude in the positions.
"""

import hashlib
import os
import typing
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from typing import ClassVar, TypeVar

import numpy as np
import numpy.typing as npt
import scipy.fft
from threadpoolctl import threadpool_limits

from eval.metrics import distributions, intervals
from eval.metrics.metric import Metric
from eval.sets.sets import Missing, Ragged, SampleSet, sample_set
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float64, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import Framerate, parse_fps

if typing.TYPE_CHECKING:
    from eval.text_motion.guo import GuoFiles

VERSION, KINEMATIC_VERSION = "clip-fid/3", "kinematic/3"
REAL, OTHER = 0, 1
"""The two sides of a comparison: each draws its own sequences."""
MULTIPLE = 4
FIT_CLIPS = 8192
FIT_FRAMES = 100_000
FIT_REPLICATION = 1_000_000
"""The seed of the descriptor's fit, different from those of all replications."""
GUO_REPLICATIONS = 5
ROWS_FOR_THREADS = 250_000

NUM_JOINTS = 22
JOINT_GROUPS: Mapping[str, tuple[int, ...]] = {
    "root": (0,),
    "legs": (1, 2, 4, 5),
    "feet": (7, 8, 10, 11),
    "hands": (18, 19, 20, 21),
    "upper": (3, 6, 9, 12, 13, 14, 15, 16, 17),
}
NUM_GROUPS = len(JOINT_GROUPS)
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

NUM_POSE_COMPONENTS = 10
SPREAD_FLOOR_METRES = 0.005
BLOCKS: Mapping[str, tuple[int, float, float]] = {
    "pose": (NUM_POSE_COMPONENTS, 1.0, 0.02),
    "spread": (NUM_POSE_COMPONENTS, 1.0, 0.25),
    "slow": (2 * NUM_GROUPS, 5.5, 0.25),
    "upper slow": (NUM_GROUPS, 0.45, 0.25),
    "speed": (NUM_GROUPS, 1.0, 0.25),
    "slip": (2, 1.3, 0.25),
    "height": (1, 1.0, 0.02),
    "direction": (1 + NUM_GROUPS, 1.0, 0.1),
}
"""Blocks of features in order: size, weight, and minimum standard deviation (metres, metres per second, logarithms).

Weights are every block's total variance on real training clips, chosen on training takes alone (docs/metrics.md).
"""
NUM_FEATURES = sum(size for size, _, _ in BLOCKS.values())

Band = tuple[float, float]
Signal = Float64[np.ndarray, "_frames _columns"]
Vectors = Float64[np.ndarray, "*batch axes"]


GROUP_MEANS = np.repeat(
    [[(joint in group) / len(group) for group in JOINT_GROUPS.values()] for joint in range(NUM_JOINTS)], 3, axis=0
)
"""Averages squared coordinates [66] over the joints of each group."""


def noise_power(bands: tuple[Band, ...], metres: float) -> Float64[np.ndarray, "bands"]:
    """Mean squared acceleration (m²/s⁴) in every band of white noise whose standard deviation at 120 fps is `metres`.

    It is that of one coordinate. Its density is metres² / 60 per Hz, of which acceleration has (2π f)⁴ times as much.
    """
    low, high = np.array(bands, dtype=np.float64).reshape(-1, 2).T
    return np.asarray(metres**2 / (NOISE_FPS / 2) * (2 * np.pi) ** 4 * (high**5 - low**5) / 5)


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
        return np.asarray(self._inverse(self._low_gain(cutoff_hz)) + self._own(self.trend), dtype=np.float64)

    def power(self, band: Band) -> Float64[np.ndarray, "_frames groups"]:
        """Squared second difference per second squared, of one band alone, averaged over the joints of each group."""
        low, high = band
        gain = (self._low_gain(high) if high < self.rate / 2 else 1.0) - self._low_gain(low)
        gain *= np.square(2 * self.rate * np.sin(np.pi * self.frequencies_hz / self.rate))
        return (np.square(self._inverse(gain)) @ GROUP_MEANS.astype(np.float32)).astype(np.float64)

    def _low_gain(self, cutoff_hz: float) -> npt.NDArray[np.float64]:
        """Squared Butterworth gain: a filter forwards and backwards; 0 for a cut-off of 0."""
        if cutoff_hz == 0:
            return np.zeros_like(self.frequencies_hz)
        return np.asarray(1.0 / (1.0 + (self.frequencies_hz / cutoff_hz) ** (2 * FILTER_ORDER)))

    def _inverse(self, gain: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
        filtered = self.values * gain.astype(np.float32)[:, None]
        return self._own(scipy.fft.irfft(filtered, n=len(self.trend), axis=0))

    def _own(self, continued: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
        return continued[self.pad : len(continued) - self.pad]


def rate_of_change(values: npt.NDArray[np.float64], rate: float) -> npt.NDArray[np.float64]:
    """Central differences per second, one-sided at the ends; 0 for a single frame."""
    return np.gradient(values, axis=0) * rate if len(values) > 1 else np.zeros_like(values)


def lengths_of(vectors: Vectors) -> Float64[np.ndarray, "*batch"]:
    """The length of each vector; several times as fast as `numpy.linalg.norm` for few coordinates."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Channels:
    """One motion below 8 Hz, a row for each pose; powers are in m²/s⁴, speeds in m/s, their logarithms natural.

    `log_foot_speed` is horizontal, of the slower foot, then of the other; a foot's speed is that of its slower joint.
    `height` is that of the lower foot in metres. `direction` are odd functions of velocity, whose means change sign
    when time runs backwards: the root's speed forwards in m/s, then the cube root of vertical speed by joint group.
    Where falling is faster than rising, it takes less time, and the mean is positive.
    """

    pose: Float64[np.ndarray, "frames 63"]
    power: Float64[np.ndarray, "frames bands groups"]
    log_speed: Float64[np.ndarray, "frames groups"]
    log_foot_speed: Float64[np.ndarray, "frames 2"]
    height: Float64[np.ndarray, "frames 1"]
    direction: Float64[np.ndarray, "frames direction"]


def channels(positions: Float[np.ndarray, "frames joints 3"], fps: Fraction) -> Channels:
    """Channels of one motion of the 22 joints of `SMPL22`, in metres, y up."""
    rate, group_means = float(fps), GROUP_MEANS[::3]
    spectrum = Spectrum.of(positions.reshape(len(positions), -1).astype(np.float64), rate)
    slow = spectrum.below(SLOW_HZ).reshape(positions.shape)
    velocity = rate_of_change(slow, rate)
    over_ground = lengths_of(velocity[:, FOOT_JOINTS][..., [0, 2]])
    feet = np.sort(over_ground.reshape(-1, len(FEET), 2).min(axis=-1), axis=-1)
    right_x, right_z = _to_the_right(slow)
    forwards = velocity[:, 0, 0] * right_z - velocity[:, 0, 2] * right_x
    return Channels(
        pose=local_poses(slow[None])[0],
        power=np.stack([spectrum.power(band) for band in SLOW_BANDS], axis=1),
        log_speed=np.log(lengths_of(velocity) + SPEED_FLOOR) @ group_means,
        log_foot_speed=np.log(feet + FOOT_SPEED_FLOOR),
        height=slow[:, FOOT_JOINTS, 1].min(axis=1, keepdims=True),
        direction=np.column_stack((forwards, np.cbrt(velocity[..., 1] @ group_means))),
    )


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


Item = TypeVar("Item")
Result = TypeVar("Result")
RowKey = TypeVar("RowKey", bound=Hashable)
Motions = Sequence[Motion] | Sequence[Float[np.ndarray, "_frames 22 3"]]
Features = Float64[np.ndarray, "clips features"]
Chosen = Int64[np.ndarray, "chosen"]


def in_threads(function: Callable[[Item], Result], items: Iterable[Item], num_rows: int) -> Iterator[Result]:
    """The results of a function of each item, in order; in threads if the items have many rows (frames, clips) in all.

    BLAS has one thread in each. For few rows, waiting for the interpreter's lock costs more than threads save.
    """
    with threadpool_limits(1, "blas"):
        if num_rows < ROWS_FOR_THREADS:
            yield from map(function, items)
        else:
            with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
                yield from pool.map(function, items)


@dataclass(frozen=True, eq=False)
class KinematicDescriptor:
    """The descriptor fitted at one framerate.

    `pose_mean` [63] and `pose_components` [10, 63] span poses relative to root and heading; `centre` and `scale`
    standardise and weigh the features.
    """

    name: ClassVar[str] = "kinematic"
    fps: Fraction
    pose_mean: Float64[np.ndarray, "coordinates"]
    pose_components: Float64[np.ndarray, "components coordinates"]
    centre: Float64[np.ndarray, "features"]
    scale: Float64[np.ndarray, "features"]

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over version, framerate and every fitted number."""
        digest = hashlib.sha256(f"{KINEMATIC_VERSION} {self.fps}".encode())
        for array in (self.pose_mean, self.pose_components, self.centre, self.scale):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return digest.hexdigest()[:16]

    def running_sums(self, samples: SampleSet) -> Ragged:
        """Sums over the poses so far of the numbers that clips average: a row for every pose, float64."""
        if samples.fps != self.fps:
            raise ValueError(f"this descriptor was fitted at {self.fps} fps; {samples.name} is at {samples.fps} fps")
        num_rows = len(samples.sequences.values)
        own = in_threads(lambda each: self.sums_of(channels(each, self.fps)), samples.sequences, num_rows)
        return Ragged.of(list(own), np.float64)

    def sums_of(self, motion: Channels) -> Float64[np.ndarray, "frames numbers"]:
        """The running sums of one motion."""
        scores = (motion.pose - self.pose_mean) @ self.pose_components.T
        power = motion.power.reshape(len(scores), -1)
        others = (motion.log_speed, motion.log_foot_speed, motion.height, motion.direction)
        rows = np.concatenate((scores, np.square(scores), power, *others), axis=1, dtype=np.float32)
        return np.cumsum(rows, axis=0, dtype=np.float64)

    def describe(self, sums: Ragged, clips: "Clips") -> Features:
        """Features of clips of a set with these running sums.

        They are means over the clip, those of powers as logarithms above their floors, standardised.
        """
        last = sums.values[clips.first_row + clips.num_poses - 1]
        is_later = clips.first_row > sums.start_row[clips.sequence]
        means = last - np.where(is_later[:, None], sums.values[clips.first_row - 1], 0.0)
        means /= clips.num_poses[:, None]
        sizes = np.cumsum((NUM_POSE_COMPONENTS, NUM_POSE_COMPONENTS, NUM_GROUPS * len(SLOW_BANDS)))
        pose, squares, power, others = np.split(means, sizes, axis=1)
        spread = 0.5 * np.log(np.maximum(squares - np.square(pose), 0.0) + SPREAD_FLOOR_METRES**2)
        floors = [noise_power((band,), metres) for band, metres in zip(SLOW_BANDS, SLOW_NOISE_METRES, strict=True)]
        log_power = 0.5 * np.log(np.maximum(power, 0.0) + np.repeat(floors, NUM_GROUPS))
        features = np.concatenate((pose, spread, log_power, others), axis=1)
        return np.asarray((features - self.centre) * self.scale, dtype=np.float64)


@typing.runtime_checkable
class FeatureSet(typing.Protocol):
    """Another feature extractor, learned or not: maps clips of one framerate to feature vectors.

    A clip's features do not depend on its batch.
    """

    @property
    def name(self) -> str:
        """Name for tables."""

    @property
    def fingerprint(self) -> str:
        """Hash of everything that the numbers depend on: definition, weights, statistics."""

    def describe(self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction) -> Features:
        """One row per clip, in order; positions in metres, y up, the 22 joints of `SMPL22`."""


class ClipError(MotionkitError):
    """A sample set that is too short for the requested clips."""


@dataclass(frozen=True)
class Protocol:
    """Number and sizes of clips, and replications; `detailed_replications` of them also get KID and PRDC.

    Clips have `min_poses` to `max_poses` poses, the same at every framerate. `resamplings` is the number of bootstrap
    samples over takes for the interval; with 0 it covers clip sampling only.
    """

    min_poses: int = 16
    max_poses: int = 64
    num_clips: int = 4096
    replications: int = 20
    detailed_replications: int = 1
    num_neighbours: int = 5
    seed: int = 0
    resamplings: int = intervals.RESAMPLINGS

    @property
    def sizes(self) -> Int64[np.ndarray, "sizes"]:
        """Clip sizes m, each equally likely: the multiples of four poses."""
        return np.arange(-(-self.min_poses // MULTIPLE) * MULTIPLE, self.max_poses + 1, MULTIPLE, dtype=np.int64)

    def check_lengths(self, samples: SampleSet) -> None:
        """Raise `ClipError` where a set has no sequence for the largest clips."""
        largest, longest = int(self.sizes.max()), int(samples.sequences.num_frames.max())
        if longest < largest:
            raise ClipError(
                f"{samples.name}: no sequence has the {largest} poses that a clip at {samples.fps} fps may need; the "
                f"longest has {longest}; lower the largest clip size or give longer motions"
            )


@dataclass(frozen=True, eq=False)
class Clips:
    """Clips of one sample set: the sequence of each, its first row and number of poses."""

    sequence: Int64[np.ndarray, "clips"]
    first_row: Int64[np.ndarray, "clips"]
    num_poses: Int64[np.ndarray, "clips"]


def draw_clips(
    samples: SampleSet, protocol: Protocol, replication: int, side: int, among: Chosen | None = None
) -> Clips:
    """The clips of one replication from a set's sequences (only `among`, if given), in proportion to their duration.

    Both sides share sizes and centres; each draws its own sequences, of those that hold the whole clip. If sequences
    were shared too, a copy of the real set would score 0 instead of the sampling floor. Raises `ClipError` where no
    sequence is long enough.
    """
    stream = (protocol.seed, samples.fps.numerator, samples.fps.denominator, replication)
    shared, own = np.random.default_rng((*stream, 0)), np.random.default_rng((*stream, 1 + side))
    num_poses = shared.choice(protocol.sizes, size=protocol.num_clips)
    centre, quantile = shared.random(protocol.num_clips), own.random(protocol.num_clips)
    sequences = np.arange(samples.num_sequences) if among is None else among
    num_frames = samples.sequences.num_frames[sequences]
    chosen = np.empty_like(num_poses)
    for size in np.unique(num_poses).tolist():
        of_size = num_poses == size
        weight = np.cumsum(np.where(num_frames >= size, num_frames, 0))
        if not len(weight) or weight[-1] == 0:
            raise ClipError(f"{samples.name}: no sequence among {len(sequences)} has {size} poses at {samples.fps} fps")
        chosen[of_size] = np.searchsorted(weight, quantile[of_size] * weight[-1], side="right")
    start = np.floor(centre * (num_frames[chosen] - num_poses + 1)).astype(np.int64)
    sequence = sequences[chosen]
    return Clips(sequence, samples.sequences.start_row[sequence] + start, num_poses)


def describer(samples: SampleSet, features: KinematicDescriptor | FeatureSet) -> Callable[[Clips], Features]:
    """A function that gives the features of clips of a set, in their order."""
    if isinstance(features, KinematicDescriptor):
        return partial(features.describe, features.running_sums(samples))

    def describe(clips: Clips) -> Features:
        """In batches of one size."""
        batches = {int(size): np.flatnonzero(clips.num_poses == size) for size in np.unique(clips.num_poses)}
        described = [
            features.describe(samples.sequences.clips(clips.first_row[rows], size), samples.fps)
            for size, rows in batches.items()
        ]
        return np.concatenate(described)[np.argsort(np.concatenate(list(batches.values())))].astype(np.float64)

    return describe


def fit_on(train: SampleSet) -> KinematicDescriptor:
    """Fit the kinematic descriptor on random takes of a training set, and standardise it on clips of them.

    A component's sign is fixed by its largest coordinate, whatever the linear algebra library.
    """
    order = np.random.default_rng((0, FIT_REPLICATION)).permutation(train.num_sequences)
    passed = np.cumsum(train.sequences.num_frames[order])
    order = order[: 1 + int(np.searchsorted(passed, FIT_FRAMES))]
    some = train.select(order)
    motions = list(in_threads(partial(channels, fps=train.fps), some.sequences, len(some.sequences.values)))
    poses = np.concatenate([motion.pose for motion in motions])
    pose_mean = poses.mean(axis=0)
    _, eigenvectors = np.linalg.eigh((poses - pose_mean).T @ (poses - pose_mean) / len(poses))
    components = eigenvectors.T[::-1][:NUM_POSE_COMPONENTS]
    largest = np.take_along_axis(components, np.abs(components).argmax(axis=1)[:, None], axis=1)
    components = np.ascontiguousarray(components * np.sign(largest))
    fitted = KinematicDescriptor(train.fps, pose_mean, components, np.zeros(NUM_FEATURES), np.ones(NUM_FEATURES))
    sums = Ragged.of(list(map(fitted.sums_of, motions)), np.float64)
    described = fitted.describe(sums, draw_clips(some, Protocol(num_clips=FIT_CLIPS), FIT_REPLICATION, REAL))
    sizes, weights, least = np.array(list(BLOCKS.values())).T
    weight, least_spread = (np.repeat(each, sizes.astype(int)) for each in (np.sqrt(weights / sizes), least))
    scale = weight / np.maximum(described.std(axis=0), least_spread)
    return replace(fitted, centre=described.mean(axis=0), scale=scale)


@dataclass(frozen=True, eq=False)
class Comparison:
    """The comparison of sample sets with the real set at one framerate; the features were fitted on `training`."""

    real: SampleSet
    features: KinematicDescriptor | FeatureSet
    protocol: Protocol
    training: SampleSet | None = None

    @cached_property
    def _describe_real(self) -> Callable[[Clips], Features]:
        return describer(self.real, self.features)

    @cached_property
    def centre(self) -> Float64[np.ndarray, "features"]:
        """The mean features of the first real clips; raises `ClipError` if these are all the same."""
        features = self._describe_real(draw_clips(self.real, self.protocol, 0, REAL))
        if (features == features[0]).all():
            raise ClipError(
                f"{self.real.name} at {self.real.fps} fps: every clip has the same {self.features.name} features, so "
                "there is no distribution to compare with; is the motion frozen?"
            )
        return np.asarray(features.mean(axis=0), dtype=np.float64)

    def scores(
        self,
        rows: Mapping[RowKey, SampleSet],
        on_replication: Callable[[], None] = lambda: None,
        subset_sizes: Mapping[RowKey, int] | None = None,
    ) -> dict[RowKey, intervals.Number]:
        """clip-FID of every row's sample set; `on_replication` is called after each replication.

        Intervals are over takes (and generations, if there are several) and the drawing of clips; without resamplings
        if the protocol has none or either side has a single take. `Number.drawing` is of clips alone. `Number.details`
        has fid_infinity (with enough clips), kid, precision, recall, density and coverage of the detailed replications.

        For rows in `subset_sizes` every replication draws another random subset of up to that many sequences that hold
        the largest clips; their interval is 1.96 standard deviations of single subsets, not of their mean. Raises
        `ClipError` if clips do not fit or the real set's features are constant, and what the features raise for another
        framerate.
        """
        subsets, real, protocol = subset_sizes or {}, self.real, self.protocol
        describers = {
            name: self._describe_real if samples is real else describer(samples, self.features)
            for name, samples in rows.items()
        }
        resampled = [
            name
            for name, samples in rows.items()
            if protocol.resamplings and name not in subsets and real.num_takes > 1 and samples.num_takes > 1
        ]
        by_take = []
        for samples in (real, *(rows[name] for name in resampled)):
            blocks = intervals.blocks_for(max(real.num_takes, samples.num_takes), self.centre.size)
            units = intervals.units_of(samples.take_names, samples.generations, blocks)
            by_take.append(intervals.UnitSums(units, self.centre))

        def replicate(replication: int) -> tuple[dict[RowKey, dict[str, float]], list[tuple[Clips, Features]]]:
            clips = draw_clips(real, protocol, replication, REAL)
            reference = self._describe_real(clips)
            compare = self._comparer(reference, replication)
            scores, described = {}, [(clips, reference)]
            for name, samples in rows.items():
                among = None
                if name in subsets:
                    long_enough = np.flatnonzero(samples.sequences.num_frames >= int(protocol.sizes.max()))
                    rng = np.random.default_rng((protocol.seed, replication, 6))
                    among = rng.choice(long_enough, size=min(subsets[name], len(long_enough)), replace=False)
                clips = draw_clips(samples, protocol, replication, OTHER, among)
                features = describers[name](clips)
                scores[name] = compare(features)
                if name in resampled:
                    described.append((clips, features))
            return scores, described

        replications: dict[RowKey, list[dict[str, float]]] = {name: [] for name in rows}
        num_clips = protocol.replications * protocol.num_clips
        for scores, described in in_threads(replicate, range(protocol.replications), num_clips * (1 + len(rows))):
            for name, each in scores.items():
                replications[name].append(each)
            for sums, (clips, features) in zip(by_take, described, strict=True):
                sums.add(features, clips.sequence)
            on_replication()
        with threadpool_limits(1, "blas"):
            fids = intervals.resampled_fids(by_take[0], by_take[1:], protocol.resamplings, protocol.seed)
        of_rows = dict(zip(resampled, fids, strict=True))
        return {
            name: self._summarised(each, of_rows.get(name, ()), name in subsets) for name, each in replications.items()
        }

    def disjoint_halves(self, on_replication: Callable[[], None] = lambda: None) -> intervals.Number:
        """clip-FID between random disjoint halves of the real takes (P2), one split per replication.

        The interval is 1.96 standard deviations of single splits. Raises `ClipError` for a single take.
        """
        real, protocol = self.real, self.protocol

        def replicate(replication: int) -> dict[str, float]:
            # Two random halves of the sequences, about equal in duration.
            order = np.random.default_rng((protocol.seed, replication, 3)).permutation(real.num_sequences)
            passed = np.cumsum(real.sequences.num_frames[order])
            middle = int(np.clip(np.searchsorted(passed, passed[-1] / 2) + 1, 1, len(order) - 1))
            first, second = (
                self._describe_real(draw_clips(real, protocol, replication, side, among))
                for side, among in ((REAL, order[:middle]), (OTHER, order[middle:]))
            )
            return self._comparer(first, replication)(second)

        replications = []
        num_clips = protocol.replications * protocol.num_clips
        for scores in in_threads(replicate, range(protocol.replications), 2 * num_clips):
            replications.append(scores)
            on_replication()
        return self._summarised(replications, (), True)

    def _comparer(self, real: Features, replication: int) -> Callable[[Features], dict[str, float]]:
        """clip-FID of features with those of `real`, and in detailed replications all further metrics."""
        gaussian, num_neighbours = distributions.fit_gaussian(real), self.protocol.num_neighbours
        is_detailed = replication < self.protocol.detailed_replications
        if is_detailed:
            kernel, radii = distributions.kernel_mean(real), distributions.squared_radii(real, num_neighbours)

        def compare(other: Features) -> dict[str, float]:
            scores = {"clip_fid": distributions.frechet_distance(gaussian, distributions.fit_gaussian(other))}
            if is_detailed:
                # FID∞ needs more than four clips per feature.
                with suppress(ValueError):
                    rng = np.random.default_rng((self.protocol.seed, replication, 4))
                    scores["fid_infinity"] = distributions.fid_infinity(real, other, rng)
                scores["kid"] = distributions.kid(real, other, kernel)
                scores |= distributions.prdc(real, other, num_neighbours, radii)
            return scores

        return compare

    def _summarised(
        self, replications: list[dict[str, float]], resampled: intervals.Resampled, single_sets: bool
    ) -> intervals.Number:
        """The mean; where each replication had its own takes, with the interval of a single one."""
        by_name = {key: [scores[key] for scores in replications if key in scores] for key in replications[0]}
        score = intervals.over_replications(by_name.pop("clip_fid"), resampled)
        if single_sets:
            score = replace(score, ci95=float(score.drawing * np.sqrt(self.protocol.replications)))
        details = {name: intervals.over_replications(values).value for name, values in by_name.items()}
        return replace(score, details=details)


@dataclass(frozen=True)
class FeatureSource:
    """A kind of features; `fit` returns the feature set for one framerate, fitted on the real training set.

    `max_replications` bounds the cost of slow features.
    """

    name: str
    title: str
    fit: Callable[[SampleSet], KinematicDescriptor | FeatureSet]
    note: str = ""
    max_replications: int | None = None

    def protocol(self, protocol: Protocol) -> Protocol:
        """A protocol with at most `max_replications`."""
        most = self.max_replications or protocol.replications
        return replace(protocol, replications=min(protocol.replications, most))

    def comparison(self, real: SampleSet, train: SampleSet, protocol: Protocol) -> Comparison:
        """A comparison with the real set, on features fitted on the training set at its framerate.

        Raises `ClipError` if a set has no sequence for the largest clips, and what fitting raises.
        """
        protocol.check_lengths(real)
        return Comparison(real, self.fit(train), self.protocol(protocol), train)


KINEMATIC = FeatureSource(
    "kinematic",
    f"clip-FID on the kinematic descriptor ({KINEMATIC_VERSION})",
    fit_on,
    "What bodies do below 8 Hz; finer motion is in the detail profile. 1 is the variance of a block of features on "
    "real training clips.",
)


def feature_sources(names: Sequence[str] | None, guo: "GuoFiles | None", missing: Missing) -> list[FeatureSource]:
    """All available feature sets, or those of these names; `missing` gets the reason why there is no other.

    Raises `UsageError` for an unknown name and for `guo` without files, and what loading `guo` raises if it is the only
    one.
    """
    if unknown := sorted(set(names or ()) - {"kinematic", "guo"}):
        raise UsageError(f"there is no feature set {unknown[0]!r}: kinematic, guo")
    if guo is None and "guo" in (names or ()):
        raise UsageError("--evaluator guo needs its weights: --weights finest.tar (docs/evaluators.md)")
    sources = [KINEMATIC] if names is None or "kinematic" in names else []
    if guo is None or (names is not None and "guo" not in names):
        return sources
    from eval.text_motion.guo import load_guo

    with missing.skipping("features 'guo'", (MotionkitError,) if sources else ()):
        evaluator = load_guo(guo)
        title = f"clip-FID on the {evaluator.name} evaluator of {evaluator.kind.dataset}"
        note = (
            f"At {float(evaluator.fps):g} fps alone, at most {GUO_REPLICATIONS} replications. This evaluator was "
            "trained to match motions with sentences: it scores upsampled and smoothed motion much like clean motion. "
            "Clips of m poses are m − 1 frames of pose vectors. These are not the FIDs of whole motions that papers "
            "print."
        )
        sources.append(FeatureSource("guo", title, lambda train: evaluator, note, GUO_REPLICATIONS))
    return sources


def clip_fid(
    real: Motions,
    generated: Motions,
    *,
    fps: Framerate | None = None,
    train: Motions | None = None,
    clips: int = 4096,
    replications: int = 20,
    seed: int = 0,
) -> intervals.Number:
    """Fréchet distance between random native-rate clips of two sets of motions at one framerate, with its interval.

    Motions are `Motion`s, brought to the 22 joints, or arrays [T, 22, 3] in metres, y up, at `fps`. Each replication
    draws `clips` clips of 16 to 64 poses from either set. The kinematic descriptor is fitted on `train`, by default on
    the real motions; tables fit it on the training split and compare with the test split (docs/evaluators.md).

    Lower is better; the floor is what other real motions score. Scores compare only with the same real motions,
    framerate and number of clips. Raises `UsageError` for several framerates, `ClipError` where no motion is long
    enough for a clip, `MotionkitError` for a skeleton that cannot be brought to the 22 joints.

    >>> store = mk.Store.open("store")
    >>> real = [motion.resample(30) for motion in store.read_many(store)]
    >>> slowed = [mk.complete(motion.resample(10), fps=30, model="slerp") for motion in real]
    >>> floor = clip_fid(real, real, clips=256, replications=3)
    >>> score = clip_fid(real, slowed, clips=256, replications=3)
    >>> score.value - score.ci95 > floor.value + floor.ci95
    True
    """
    motions = {"real": real, "generated": generated, "train": real if train is None else train}
    sets = samples_at_one_framerate(motions, fps)
    protocol = Protocol(num_clips=clips, replications=replications, detailed_replications=0, seed=seed)
    comparison = KINEMATIC.comparison(sets["real"], sets["train"], protocol)
    return comparison.scores({"generated": sets["generated"]})["generated"]


SOURCE, CALIBRATION = f"NeRM §4.2, as {VERSION}", "motionkit eval --calibrate"
CLIP_FID = Metric("clip_fid", "clip-FID", "", False, SOURCE, clip_fid, calibration=CALIBRATION)


def samples_at_one_framerate(sets: Mapping[str, Motions], fps: Framerate | None) -> dict[str, SampleSet]:
    """Sets of motions as sample sets of 22 joints, by name.

    Raises `UsageError` for several framerates, for another one than `fps`, or for none, and what `samples_of` raises.
    """
    rates = set() if fps is None else {parse_fps(fps)}
    rates |= {motion.fps for motions in sets.values() for motion in motions if isinstance(motion, Motion)}
    if len(rates) != 1:
        listed = ", ".join(str(rate) for rate in sorted(rates)) or "none (arrays need fps=…)"
        raise UsageError(f"motions at one framerate are compared, these have {listed}: motion.resample(fps) changes it")
    return {name: samples_of(name, motions, *rates) for name, motions in sets.items()}


def samples_of(name: str, motions: Iterable[Motion | Float[np.ndarray, "_frames 22 3"]], fps: Fraction) -> SampleSet:
    """Motions as a sample set of 22 joints. Raises `ClipError` for none and `UsageError` for arrays of other shapes."""
    joints = [
        map_joints(each, SMPL22.name) if isinstance(each, Motion) else np.asarray(each, np.float32) for each in motions
    ]
    if not joints:
        raise ClipError(f"{name} holds no motion")
    for number, each in enumerate(joints):
        if each.ndim != 3 or each.shape[1:] != (SMPL22.num_joints, 3):
            raise UsageError(f"{name}[{number}] has the shape {each.shape}, expected [frames, 22, 3] in metres")
    return sample_set(name, fps, joints, [str(number) for number in range(len(joints))])
