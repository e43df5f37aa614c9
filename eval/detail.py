"""The detail profile: how fine motion is, in three figures that are never summed.

Timing T: how far power at 12 to 27 Hz comes when slow motion predicts it, as a share of real motion's. Energy E: power
by frequency band, in dB relative to real motion. Rigidity R: by how much bones change their length above 8 Hz, in mm.
White noise has energy and no timing, noise that is timed bends bones or is too quiet, and smooth motion has neither
energy nor timing: what wins one figure is seen by another (docs/metrics.md).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import pairwise

import numpy as np
import scipy.ndimage

from eval.clip_fid.score import (
    FOOT_JOINTS,
    GROUP_MEANS,
    NUM_GROUPS,
    SLOW_BANDS,
    Band,
    ClipError,
    Motions,
    Signal,
    Spectrum,
    in_threads,
    lengths_of,
    noise_power,
    rate_of_change,
    samples_at_one_framerate,
)
from eval.metrics.intervals import units_of
from eval.sets.sets import SampleSet
from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import Framerate

VERSION = "detail/1"
LEAST_FPS = Fraction(40)
"""Slower motion holds no whole band."""
BAND_EDGES_HZ = (12.0, 18.0, 27.0, 40.0, 60.0)
TIMED_BELOW_HZ = 27.0
"""Above, slow motion predicts nothing."""
PREDICTED_FROM_HZ = 6.0
BONES_ABOVE_HZ = 8.0
ENERGY_NOISE_METRES = 0.0002
TIMING_NOISE_METRES = 0.001
SLOW_NOISE_METRES = 0.002
"""Floors under logarithms of power: white noise of this standard deviation at 120 fps."""
ENVELOPE_SECONDS = 0.06
LOCAL_SECONDS = 1.0
LAG_SECONDS = 0.04
SPEED_FLOOR, ACCELERATION_FLOOR, JERK_FLOOR = 0.03, 1.0, 10.0
VELOCITY_SCALE, FAST_SPEED, ACCELERATION_SCALE = 0.5, 0.5, 10.0
"""Metres per second, and per second squared, at which bounded predictors reach half of their limit."""
NEAR_METRES, FALLING_SPEED, BRAKING_ACCELERATION = 0.05, 0.3, 5.0
STEADY_RIDGE, RIDGE = 0.003, 0.1
"""Chosen by leaving out performers of CMU, cmu-more and HDM05 at 120 fps in five folds."""
DECIBELS = 10.0 / np.log(10.0)
HALVINGS = 200
LEAST_RANGE_MM = 0.05
"""Change of bones that resampling a capture makes."""
SUDDEN_JOINTS = (*FOOT_JOINTS, 0, 20, 21)
PARENTS = list(SMPL22.parents[1:])
Weights = Float64[np.ndarray, "channels timed"]
Figures = Float64[np.ndarray, "draws figures"]


def bands_at(fps: Fraction) -> tuple[Band, ...]:
    """Frequency bands in Hz of which at least half lies below the Nyquist frequency, cut off there."""
    nyquist = float(fps) / 2
    return tuple(
        (low, min(high, nyquist)) for low, high in pairwise(BAND_EDGES_HZ) if nyquist - low >= (high - low) / 2
    )


@dataclass(frozen=True, eq=False)
class MotionFigures:
    """What averages over motions need, a row for each motion of a set.

    `timing` are Σ power · prediction and Σ prediction² over frames, `log_power` sums over frames of means over groups.
    """

    num_frames: Float64[np.ndarray, "motions"]
    timing: Float64[np.ndarray, "motions 2"]
    log_power: Float64[np.ndarray, "motions bands"]
    bones_mm: Float64[np.ndarray, "motions"]

    def averages(self, weights: Float64[np.ndarray, "draws motions"]) -> Figures:
        """Slope, dB by band and median rigidity for every row of weights of the motions."""
        products, squares = (weights @ self.timing).T
        energy = DECIBELS * (weights @ self.log_power) / (weights @ self.num_frames)[:, None]
        order = np.argsort(self.bones_mm)
        passed = np.cumsum(weights[:, order], axis=1)
        middle = order[(passed >= passed[:, -1:] / 2).argmax(axis=1)]
        slope = products / np.maximum(squares, 1e-12)
        return np.concatenate((slope[:, None], energy, self.bones_mm[middle, None]), axis=1)


def _fitted_on(training: SampleSet) -> tuple[Weights, MotionFigures]:
    """The weights that predict timing, and the figures of the motions that they were fitted on.

    Sudden motion explains what steady motion does not: noise that is added where joints are fast follows speed too.
    """
    motions = _channels_of(training)
    steady, sudden, timed = (
        np.concatenate([getattr(motion, name) for motion in motions]) for name in ("steady", "sudden", "timed")
    )
    steady_scale, sudden_scale = (1.0 / (values.std(axis=0) + 1e-9) for values in (steady, sudden))
    steady, sudden = steady * steady_scale, sudden * sudden_scale
    shared = _ridge(steady, sudden, STEADY_RIDGE)
    weights = _ridge(sudden - steady @ shared, timed, RIDGE)
    weights = np.concatenate((-steady_scale[:, None] * (shared @ weights), sudden_scale[:, None] * weights))
    return weights, _figures(motions, weights)


def _figures(motions: Sequence["_Channels"], weights: Weights) -> MotionFigures:
    timing = []
    for motion in motions:
        prediction = np.concatenate((motion.steady, motion.sudden), axis=1) @ weights
        timing.append([(motion.timed * prediction).sum(), np.square(prediction).sum()])
    return MotionFigures(
        num_frames=np.array([float(len(motion.timed)) for motion in motions]),
        timing=np.array(timing),
        log_power=np.array([motion.log_power.sum(axis=0) for motion in motions]),
        bones_mm=np.array([motion.bones_mm for motion in motions]),
    )


@dataclass(frozen=True, eq=False)
class _Channels:
    """One motion's numbers for a profile: predictors of timing, and what they predict, without their local means.

    `steady` are slow power and speeds of joint groups, `sudden` vertical motion of feet, root and hands, feet near the
    floor, accelerations and jerks; `timed` is log power in the timed bands; `bones_mm` is the root mean square over
    frames and bones of bone lengths above 8 Hz.
    """

    steady: Float64[np.ndarray, "frames steady"]
    sudden: Float64[np.ndarray, "frames sudden"]
    timed: Float64[np.ndarray, "frames timed"]
    log_power: Float64[np.ndarray, "frames bands"]
    bones_mm: float


def _channels_of(samples: SampleSet) -> list[_Channels]:
    return list(in_threads(partial(_channels, fps=samples.fps), samples.sequences, len(samples.sequences.values)))


def _channels(positions: Float32[np.ndarray, "frames joints 3"], fps: Fraction) -> _Channels:
    rate, bands, num = float(fps), bands_at(fps), len(positions)
    num_timed = sum(low < TIMED_BELOW_HZ for low, _ in bands)
    spectrum = Spectrum.of(positions.reshape(num, -1).astype(np.float64), rate)

    def envelopes(bands: tuple[Band, ...]) -> Float64[np.ndarray, "frames bands groups"]:
        power = [spectrum.power(band) for band in bands]
        return smoothed(np.concatenate(power, axis=1), ENVELOPE_SECONDS, rate).reshape(num, len(bands), NUM_GROUPS)

    slow = spectrum.below(PREDICTED_FROM_HZ).reshape(positions.shape)
    velocity = rate_of_change(slow, rate)
    acceleration = rate_of_change(velocity, rate)
    speed, jerk = lengths_of(velocity), lengths_of(rate_of_change(acceleration, rate))
    log_speed, group_means = np.log(speed + SPEED_FLOOR), GROUP_MEANS[::3]
    slow_power = np.log(envelopes(SLOW_BANDS[:2]) + noise_power(SLOW_BANDS[:2], SLOW_NOISE_METRES)[:, None])
    fast = envelopes(bands)
    timed = np.log(fast + noise_power(bands, TIMING_NOISE_METRES)[:, None])[:, :num_timed].reshape(num, -1)
    steady = (slow_power.reshape(num, -1), log_speed @ group_means, (speed / (speed + FAST_SPEED)) @ group_means)
    sudden = (
        log_speed[:, FOOT_JOINTS],
        np.arctan(velocity[:, FOOT_JOINTS, 1] / VELOCITY_SCALE),
        np.arctan(acceleration[:, SUDDEN_JOINTS, 1] / ACCELERATION_SCALE),
        *_near_the_floor(slow[:, FOOT_JOINTS, 1], velocity[:, FOOT_JOINTS], acceleration[:, FOOT_JOINTS, 1]),
        np.log(lengths_of(acceleration) + ACCELERATION_FLOOR) @ group_means,
        np.log(jerk + JERK_FLOOR) @ group_means,
    )
    bones = lengths_of(positions[:, 1:].astype(np.float64) - positions[:, PARENTS])
    return _Channels(
        steady=_lagged(np.concatenate(steady, axis=1), rate),
        sudden=_lagged(np.concatenate(sudden, axis=1), rate),
        timed=timed - smoothed(timed, LOCAL_SECONDS, rate),
        log_power=np.log(fast + noise_power(bands, ENERGY_NOISE_METRES)[:, None]).mean(axis=2),
        bones_mm=1000.0 * float(np.sqrt(np.mean(np.square(bones - Spectrum.of(bones, rate).below(BONES_ABOVE_HZ))))),
    )


def _near_the_floor(heights: Signal, velocity: Float64[np.ndarray, "frames feet 3"], lift: Signal) -> list[Signal]:
    """Falling, braking and moving of each foot joint, faded out within some centimetres above its own floor."""
    near = np.exp(-np.maximum(heights - np.percentile(heights, 5, axis=0), 0.0) / NEAR_METRES)
    falling, braking = np.maximum(-velocity[..., 1], 0.0) / FALLING_SPEED, np.maximum(lift, 0.0) / BRAKING_ACCELERATION
    return [near * np.log1p(each) for each in (falling, braking, lengths_of(velocity) / FALLING_SPEED)]


def smoothed(values: Signal, seconds: float, rate: float) -> Signal:
    """Means over a Hann window of about so many seconds, an odd number of frames, reflected at the ends."""
    num = min(max(1, round(seconds * rate)) | 1, (len(values) - 1) | 1)
    if num < 3:
        return values
    window = np.hanning(num + 2)[1:-1]
    return np.asarray(scipy.ndimage.convolve1d(values, window / window.sum(), axis=0, mode="reflect"))


def _lagged(values: Signal, rate: float) -> Signal:
    """Deviations from the local mean, now, 40 ms later and 40 ms earlier, side by side."""
    lag = max(1, round(LAG_SECONDS * rate))
    deviation = values - smoothed(values, LOCAL_SECONDS, rate)
    padded = np.pad(deviation, ((lag, lag), (0, 0)), mode="edge")
    return np.concatenate((deviation, padded[2 * lag :], padded[: -2 * lag]), axis=1)


def _ridge(predictors: Signal, target: Signal, share: float) -> Float64[np.ndarray, "predictors targets"]:
    penalty = share * len(predictors) * np.eye(predictors.shape[1])
    return np.linalg.solve(predictors.T @ predictors + penalty, predictors.T @ target)


@dataclass(frozen=True)
class Figure:
    """One figure of a set: its value, its 95 % interval over takes, and the 95 % range of real takes.

    `real_range` is that of random halves of the real takes beside their other halves; of rigidity from 0 to at least
    0.05 mm. None with fewer than four takes.
    """

    value: float
    interval: tuple[float, float]
    real_range: tuple[float, float] | None

    @property
    def is_real(self) -> bool:
        """Whether real takes show such values."""
        return self.real_range is None or self.real_range[0] <= self.value <= self.real_range[1]


@dataclass(frozen=True)
class DetailProfile:
    """Timing as a share of real motion's, energy in dB relative to real motion by band in Hz, rigidity in mm."""

    fps: Fraction
    timing: Figure
    energy_db: Mapping[Band, Figure]
    rigidity_mm: Figure

    @property
    def figures(self) -> dict[str, Figure]:
        """All figures by their names in tables."""
        energy = {f"{low:g}–{high:g} Hz": each for (low, high), each in self.energy_db.items()}
        return {"T": self.timing, **energy, "R": self.rigidity_mm}

    def __str__(self) -> str:
        lines = [f"detail profile ({VERSION}) at {self.fps} fps, [95 % over takes], real takes"]
        for name, each in self.figures.items():
            low, high = each.interval
            floor = "" if each.real_range is None else f"{each.real_range[0]:7.2f} … {each.real_range[1]:.2f}"
            mark = "" if each.is_real else "  outside"
            lines.append(f"{name:16} {each.value:7.2f} [{low:.2f}, {high:.2f}] {floor}{mark}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class RealDetail:
    """The real side of a profile, for any number of sets at one framerate.

    `weights` predict log power of joint groups at 12 to 27 Hz from steady and sudden channels below 6 Hz, both as
    deviations from the mean over a second. `known` are the figures of the real and the training motions, `ranges` [2,
    figures] those of `Figure.real_range`.
    """

    real: SampleSet
    weights: Weights
    known: Mapping[SampleSet, MotionFigures]
    ranges: Float64[np.ndarray, "2 figures"] | None
    seed: int

    @classmethod
    def of(cls, real: SampleSet, train: SampleSet, seed: int = 0) -> "RealDetail":
        """With the predictor fitted on the training set.

        Raises `UsageError` below 40 fps, and `ClipError` for real motion that has no timing to compare with.
        """
        if real.fps < LEAST_FPS:
            raise UsageError(f"the detail profile needs {LEAST_FPS} fps or more, these motions have {real.fps} fps")
        weights, of_training = _fitted_on(train)
        figures = of_training if real is train else _figures(_channels_of(real), weights)
        if not figures.timing[:, 0].sum():
            raise ClipError(f"{real.name} at {real.fps} fps: no fast motion follows slow motion; is it frozen?")
        known = {train: of_training, real: figures}
        return cls(real, weights, known, _ranges_of_halves(figures, real, seed), seed)

    @property
    def real_slope(self) -> float:
        """Real motion's own timing: about 1 on the motions that the predictor was fitted on, less on others."""
        return float(self.known[self.real].averages(np.ones((1, self.real.num_sequences)))[0, 0])

    def profile(self, samples: SampleSet) -> DetailProfile:
        """The profile of one set; raises `ValueError` for another framerate."""
        if samples.fps != self.real.fps:
            raise ValueError(f"these profiles are at {self.real.fps} fps; {samples.name} is at {samples.fps} fps")
        real = self.known[self.real]
        figures = self.known[samples] if samples in self.known else _figures(_channels_of(samples), self.weights)
        value = _relative(
            figures.averages(np.ones((1, samples.num_sequences))), real.averages(np.ones((1, self.real.num_sequences)))
        )[0]
        # How often each motion is drawn in every resampling: paired between the sets by the takes' names.
        units = [units_of(each.take_names, each.generations) for each in (samples, self.real)]
        weights, real_weights = (each.weights(seed=self.seed)[:, each.unit] for each in units)
        drawn = weights.any(axis=1) & real_weights.any(axis=1)
        draws = _relative(figures.averages(weights[drawn]), real.averages(real_weights[drawn]))
        intervals = np.nanpercentile(draws, (2.5, 97.5), axis=0)
        ranges = [None] * len(value) if self.ranges is None else list(zip(*self.ranges.tolist(), strict=True))
        timing, *energy, rigidity = map(Figure, value.tolist(), zip(*intervals.tolist(), strict=True), ranges)
        by_band = dict(zip(bands_at(samples.fps), energy, strict=True))
        return DetailProfile(samples.fps, timing, by_band, rigidity)


def _relative(figures: Figures, real: Figures) -> Figures:
    """Timing as a share of the real one (nan where that is 0), energy as a difference, rigidity as it is."""
    share = np.divide(figures[:, :1], real[:, :1], out=np.full((len(figures), 1), np.nan), where=real[:, :1] != 0)
    return np.concatenate((share, figures[:, 1:-1] - real[:, 1:-1], figures[:, -1:]), axis=1)


def _ranges_of_halves(figures: MotionFigures, real: SampleSet, seed: int) -> Float64[np.ndarray, "2 figures"] | None:
    """95 % ranges of the figures of random halves of the takes beside the other halves; None for fewer than four."""
    takes, take = np.unique(real.take_names, return_inverse=True)
    if len(takes) < 4:
        return None
    rng = np.random.default_rng((seed, 10))
    halves = np.stack([rng.permutation(len(takes)) < len(takes) // 2 for _ in range(HALVINGS)])[:, take].astype(float)
    both = _relative(figures.averages(halves), figures.averages(1.0 - halves))
    ranges: Float64[np.ndarray, "2 figures"] = np.nanpercentile(both, (2.5, 97.5), axis=0)
    ranges[:, -1] = 0.0, max(ranges[1, -1], LEAST_RANGE_MM)
    return ranges


def detail_profile(
    real: Motions, generated: Motions, *, fps: Framerate | None = None, train: Motions | None = None, seed: int = 0
) -> DetailProfile:
    """The detail profile of generated motions beside real ones, at one framerate of at least 40 fps.

    Motions are `Motion`s, brought to the 22 joints, or arrays [T, 22, 3] in metres, y up, at `fps`. The predictor of
    timing is fitted on `train`, by default on the real motions; tables fit it on the training split.

    Raises `UsageError` for several framerates or below 40 fps, `ClipError` for frozen real motions, and
    `MotionkitError` for a skeleton that cannot be brought to the 22 joints.

    >>> walks = [np.random.default_rng(n).normal(size=(240, 22, 3)).cumsum(axis=0) / 100 for n in range(6)]
    >>> half_as_lively = [0.5 * walk for walk in walks]
    >>> profile = detail_profile(walks, half_as_lively, fps=60)
    >>> round(profile.energy_db[12.0, 18.0].value)
    -6
    """
    sets = {"real": real, "generated": generated, "train": real if train is None else train}
    samples = samples_at_one_framerate(sets, fps)
    return RealDetail.of(samples["real"], samples["train"], seed).profile(samples["generated"])
