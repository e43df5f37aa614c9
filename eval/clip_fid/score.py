"""clip-FID as this project defines it: a distance between features of random native-rate clips.

The NeRM paper (§4.2) compares random clips of m poses at framerate s around a centre v, real against generated, without
resampling either; m, the number of clips, the extractor and the real set at a target rate are this project's choices,
and `VERSION` is raised whenever one of them changes. Not the FID of images on CLIP features that other tools call
clip-FID.
"""

import typing
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from eval.clip_fid.descriptor import VERSION as KINEMATIC_VERSION
from eval.clip_fid.descriptor import KinematicDescriptor, channels, fit_kinematic, in_threads, standardised
from eval.metrics.distributions import (
    fid_infinity,
    fit_gaussian,
    frechet_distance,
    kid,
    prdc,
)
from eval.metrics.metric import Metric
from eval.metrics.number import (
    RESAMPLINGS,
    Number,
    Resampled,
    Resampling,
    Units,
    UnitSums,
    blocks_for,
    over_replications,
    resampled_fids,
    units_of,
)
from eval.sets.sets import Missing, Ragged, SampleSet, sample_set
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float64, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import Framerate, parse_fps

if typing.TYPE_CHECKING:
    from eval.text_motion.guo import GuoFiles

VERSION = "clip-fid/3"
REAL, OTHER = 0, 1
"""The two sides of a comparison: each draws its own sequences."""
MULTIPLE = 4
FIT_CLIPS = 8192
FIT_FRAMES = 100_000
FIT_REPLICATION = 1_000_000
"""The seed of the descriptor's fit, different from those of all replications."""
GUO_REPLICATIONS = 5

RowKey = TypeVar("RowKey", bound=Hashable)
Motions = Sequence[Motion] | Sequence[Float[np.ndarray, "_frames 22 3"]]
Features = Float64[np.ndarray, "clips features"]
Chosen = Int64[np.ndarray, "chosen"]


class ClipError(MotionkitError):
    """A sample set that is too short for the requested clips."""


@typing.runtime_checkable
class FeatureSet(typing.Protocol):
    """A feature extractor, learned or not: maps clips of one framerate to feature vectors.

    A clip's features do not depend on its batch.
    """

    @property
    def name(self) -> str:
        """Name for tables."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash of everything that the numbers depend on: definition, weights, statistics."""
        ...

    def describe(self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction) -> Features:
        """One row per clip, in order; positions in metres, y up, the 22 joints of `SMPL22`."""
        ...


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
    resamplings: int = RESAMPLINGS

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

    Both sides share sizes and centres, which are uniform over the positions on the frame grid; each side draws its own
    sequences, of those that hold the whole clip. If sequences were shared too, a copy of the real set would score 0
    instead of the sampling floor. Raises `ClipError` where no sequence is long enough.
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


def feature_input(samples: SampleSet, features: FeatureSet) -> SampleSet:
    """The sample set with the features' input per pose: positions, or for the kinematic descriptor its rows."""
    if not isinstance(features, KinematicDescriptor) or samples.sequences.values.ndim != 3:  # or they are rows already
        return samples
    return replace(samples, sequences=features.frames(samples), local_rotations=None)


def describe_clips(samples: SampleSet, clips: Clips, features: FeatureSet) -> Features:
    """Features of clips of the output of `feature_input`, in their order, batched by size."""
    order = np.argsort(clips.num_poses, kind="stable")
    sizes, starts = np.unique(clips.num_poses[order], return_index=True)
    batches = [
        features.describe(samples.sequences.clips(clips.first_row[rows], int(size)), samples.fps)
        for size, rows in zip(sizes, np.split(order, starts[1:]), strict=True)
    ]
    result = np.empty((len(order), batches[0].shape[1]))
    result[order] = np.concatenate(batches)
    return result


def fit_on(train: SampleSet, seed: int = 0) -> KinematicDescriptor:
    """Fit the kinematic descriptor on random takes of a training set, and standardise it on clips of them."""
    order = np.random.default_rng((seed, FIT_REPLICATION)).permutation(train.num_sequences)
    passed = np.cumsum(train.sequences.num_frames[order])
    some = train.select(order[: 1 + int(np.searchsorted(passed, FIT_FRAMES))])
    motions = list(in_threads(partial(channels, fps=train.fps), some.sequences))
    fitted = fit_kinematic(motions, train.fps)
    rows = replace(some, sequences=Ragged.of(list(map(fitted.rows, motions))), local_rotations=None)
    clips = draw_clips(rows, Protocol(num_clips=FIT_CLIPS, seed=seed), FIT_REPLICATION, REAL)
    return standardised(fitted, describe_clips(rows, clips, fitted))


@dataclass(frozen=True, eq=False)
class Comparison:
    """The comparison of sample sets with the real set at one framerate; the features were fitted on `training`."""

    real: SampleSet
    features: FeatureSet
    protocol: Protocol
    training: SampleSet | None = None

    @cached_property
    def _real(self) -> SampleSet:
        return feature_input(self.real, self.features)

    @property
    def num_features(self) -> int:
        """Number of features of a clip."""
        clip = self._real.sequences.clips(np.zeros(1, dtype=np.int64), int(self.protocol.sizes.min()))
        return int(self.features.describe(clip, self.real.fps).shape[1])

    def scores(
        self,
        rows: Mapping[RowKey, SampleSet],
        on_replication: Callable[[], None] = lambda: None,
        subset_sizes: Mapping[RowKey, int] | None = None,
    ) -> dict[RowKey, Number]:
        """clip-FID of every row's sample set.

        Intervals are over takes (and generations, if there are several) and the drawing of clips; `Number.drawing` is
        of clips alone. `Number.details` has fid_infinity, kid, precision, recall, density and coverage: empty without
        detailed replications, no fid_infinity with too few clips. There are no resamplings if the protocol has none, or
        either side has a single take.

        `on_replication` is called after each replication. For rows in `subset_sizes` every replication takes another
        random subset of that many sequences; their interval is 1.96 standard deviations of single subsets, not of their
        mean. Raises `ClipError` if clips do not fit or the real set's features are constant, and `ValueError` for
        different framerates.
        """
        subsets, protocol = subset_sizes or {}, self.protocol
        for samples in rows.values():
            if samples.fps != self.real.fps:
                raise ValueError(f"{samples.name} is at {samples.fps} fps, the real set at {self.real.fps}")
        sets = {
            name: self._real if samples is self.real else feature_input(samples, self.features)
            for name, samples in rows.items()
        }
        real, whole = self._real, [name for name in sets if name not in subsets]

        def replicate(replication: int) -> tuple[dict[RowKey, dict[str, float]], list[_Described]]:
            reference = self._described(real, replication, REAL)
            if (reference.features == reference.features[0]).all():
                raise ClipError(
                    f"{real.name} at {real.fps} fps: every clip has the same {self.features.name} features, so there "
                    "is no distribution to compare with; is the motion frozen?"
                )
            scores, described = {}, [reference]
            for name, samples in sets.items():
                among = self._subset(samples, subsets[name], replication) if name in subsets else None
                other = self._described(samples, replication, OTHER, among)
                scores[name] = self._compare(reference.features, other.features, replication)
                if among is None:
                    described.append(other)
            return scores, described

        takes = _Takes([real, *(sets[name] for name in whole)], protocol) if protocol.resamplings else None
        replications = []
        for scores, described in in_threads(replicate, range(protocol.replications)):
            replications.append(scores)
            if takes is not None:
                takes.add(described)
            on_replication()
        resampled = {} if takes is None else dict(zip(whole, takes.scores(), strict=True))
        found = {}
        for name in rows:
            summary = _summarise([scores[name] for scores in replications], resampled.get(name, ()))
            found[name] = self._of_single_sets(summary) if name in subsets else summary
        return found

    def disjoint_halves(self, on_replication: Callable[[], None] = lambda: None) -> Number:
        """clip-FID between random disjoint halves of the real takes (P2), one split per replication.

        The interval is 1.96 standard deviations of single splits. Raises `ClipError` for a single take.
        """
        real, protocol = self._real, self.protocol
        if real.num_sequences < 2:
            raise ClipError(f"{real.name}: {real.num_sequences} take cannot be split into two halves")

        def replicate(replication: int) -> dict[str, float]:
            # Two random halves of the sequences, about equal in duration.
            order = np.random.default_rng((protocol.seed, replication, 3)).permutation(real.num_sequences)
            passed = np.cumsum(real.sequences.num_frames[order])
            middle = int(np.clip(np.searchsorted(passed, passed[-1] / 2) + 1, 1, len(order) - 1))
            a = self._described(real, replication, REAL, order[:middle]).features
            b = self._described(real, replication, OTHER, order[middle:]).features
            return self._compare(a, b, replication)

        replications = []
        for scores in in_threads(replicate, range(protocol.replications)):
            replications.append(scores)
            on_replication()
        return self._of_single_sets(_summarise(replications))

    def _described(self, samples: SampleSet, replication: int, side: int, among: Chosen | None = None) -> "_Described":
        clips = draw_clips(samples, self.protocol, replication, side, among)
        return _Described(describe_clips(samples, clips, self.features), clips.sequence)

    def _subset(self, samples: SampleSet, size: int, replication: int) -> Chosen:
        """Up to `size` random sequences that are long enough for the largest clips."""
        long_enough = np.flatnonzero(samples.sequences.num_frames >= int(self.protocol.sizes.max()))
        rng = np.random.default_rng((self.protocol.seed, replication, 6))
        return rng.choice(long_enough, size=min(size, len(long_enough)), replace=False)

    def _compare(self, real: Features, other: Features, replication: int) -> dict[str, float]:
        """clip-FID, and in detailed replications all further metrics."""
        scores = {"clip_fid": frechet_distance(fit_gaussian(real), fit_gaussian(other))}
        if replication < self.protocol.detailed_replications:
            rng = np.random.default_rng((self.protocol.seed, replication, 4))
            # FID∞ needs more than four clips per feature.
            with suppress(ValueError):
                scores["fid_infinity"] = fid_infinity(real, other, rng)
            scores["kid"] = kid(real, other)
            scores |= prdc(real, other, self.protocol.num_neighbours)
        return scores

    def _of_single_sets(self, found: Number) -> Number:
        """With the interval of a single replication instead of the mean's: each had its own takes."""
        return replace(found, ci95=float(found.drawing * np.sqrt(self.protocol.replications)))


def _summarise(replications: list[dict[str, float]], resampled: Resampled = ()) -> Number:
    by_name = {key: [scores[key] for scores in replications if key in scores] for key in replications[0]}
    clip_fid = over_replications(by_name.pop("clip_fid"), resampled)
    return replace(clip_fid, details={name: over_replications(values).value for name, values in by_name.items()})


@dataclass(frozen=True, eq=False)
class _Described:
    """Features of clips, and each clip's sequence."""

    features: Features
    sequence: Int64[np.ndarray, "clips"]


class _Takes:
    """Statistics of each take of a comparison's sets, the real one first, from the clips of all replications."""

    def __init__(self, sets: list[SampleSet], protocol: Protocol) -> None:
        self._sets, self._resampling = sets, Resampling(protocol.resamplings, protocol.seed)
        self._units: list[Units] = []
        self._sums: list[UnitSums] = []

    def add(self, described: list[_Described]) -> None:
        """The clips of one replication of every set."""
        if not self._sums:
            centre, most = described[0].features.mean(axis=0), self._sets[0].num_takes
            for each in self._sets:
                blocks = blocks_for(max(most, each.num_takes), centre.size)
                self._units.append(units_of(each.take_names, each.generations, blocks))
                self._sums.append(UnitSums(len(self._units[-1].takes), centre))
        for clips, units, sums in zip(described, self._units, self._sums, strict=True):
            sums.add(clips.features, units.unit[clips.sequence])

    def scores(self) -> list[Resampled]:
        """Every row's bootstrap scores; empty if the real set or the row has a single take."""
        real, *others = zip(self._sums, self._units, strict=True)
        several = [each.num_takes > 1 and self._sets[0].num_takes > 1 for each in self._sets[1:]]
        with threadpool_limits(1, "blas"):
            chosen = [other for other, enough in zip(others, several, strict=True) if enough]
            found = iter(resampled_fids(*real, chosen, self._resampling))
        return [next(found) if enough else () for enough in several]


@dataclass(frozen=True)
class FeatureSource:
    """A kind of features; `fit` returns the feature set for one framerate, fitted on the real training set.

    `max_replications` bounds the cost of slow features.
    """

    name: str
    title: str
    fit: Callable[[SampleSet], FeatureSet]
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
    name="kinematic",
    title=f"clip-FID on the kinematic descriptor ({KINEMATIC_VERSION})",
    fit=fit_on,
    note=(
        "What bodies do below 8 Hz; finer motion is in the detail profile. 1 is the variance of a block of features on "
        "real training clips."
    ),
)


def feature_sources(names: Sequence[str] | None, guo: "GuoFiles | None", missing: Missing) -> list[FeatureSource]:
    """All available feature sets, or those of these names; `missing` gets the reason why there is no other.

    Raises `UsageError` for an unknown name and for `guo` without files, and what is wrong with the files if `guo` is
    the only one.
    """
    if unknown := sorted(set(names or ()) - {"kinematic", "guo"}):
        raise UsageError(f"there is no feature set {unknown[0]!r}: kinematic, guo")
    if guo is None and "guo" in (names or ()):
        raise UsageError("--evaluator guo needs its weights: --weights finest.tar (docs/evaluators.md)")
    sources = [KINEMATIC] if names is None or "kinematic" in names else []
    if guo is not None and (names is None or "guo" in names):
        with missing.skipping("features 'guo'", (MotionkitError,) if sources else ()):
            sources.append(guo_source(guo))
    return sources


def guo_source(files: "GuoFiles") -> FeatureSource:
    """A published evaluator at its own framerate. Raises `MotionkitError` if its files are invalid."""
    from eval.text_motion.guo import load_guo

    evaluator = load_guo(files)

    def at_its_framerate(train: SampleSet) -> FeatureSet:
        evaluator.check_fps(train.fps, train.name)
        return evaluator

    return FeatureSource(
        name="guo",
        title=f"clip-FID on the {evaluator.name} evaluator of {evaluator.kind.dataset}",
        fit=at_its_framerate,
        note=(
            f"At {float(evaluator.fps):g} fps alone, at most {GUO_REPLICATIONS} replications. This evaluator was "
            "trained to match motions with sentences: it scores upsampled and smoothed motion much like clean motion. "
            "Clips of m poses are m − 1 frames of pose vectors. These are not the FIDs of whole motions that papers "
            "print."
        ),
        max_replications=GUO_REPLICATIONS,
    )


def clip_fid(
    real: Motions,
    generated: Motions,
    *,
    fps: Framerate | None = None,
    train: Motions | None = None,
    clips: int = 4096,
    replications: int = 20,
    seed: int = 0,
) -> Number:
    """Fréchet distance between random native-rate clips of two sets of motions at one framerate, with its interval.

    Motions are `Motion`s, brought to the 22 joints, or arrays [T, 22, 3] in metres, y up, at `fps`. Each replication
    draws `clips` clips of 16 to 64 poses from either set. The kinematic descriptor is fitted on `train`, by default on
    the real motions; tables fit it on the training split and compare with the test split (docs/evaluators.md).

    Lower is better, and 0 is not reached but by one motion beside itself: the floor is what other real motions score.
    Scores compare only with the same real motions, framerate and number of clips.

    Raises `UsageError` for motions of several framerates or of another one than `fps`, `ClipError` where no motion is
    long enough for a clip, `MotionkitError` for a skeleton that cannot be brought to the 22 joints.

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


CLIP_FID = Metric(
    "clip_fid",
    "clip-FID",
    "",
    False,
    f"NeRM §4.2, as {VERSION}",
    clip_fid,
    calibration="motionkit eval --calibrate",
)


def samples_at_one_framerate(sets: Mapping[str, Motions], fps: Framerate | None) -> dict[str, SampleSet]:
    """Sets of motions as sample sets of 22 joints, by name.

    Raises `UsageError` for several framerates, for another one than `fps`, or for none, and what `samples_of` raises.
    """
    rates = set() if fps is None else {parse_fps(fps)}
    rates |= {motion.fps for motions in sets.values() for motion in motions if isinstance(motion, Motion)}
    if len(rates) != 1:
        found = ", ".join(str(rate) for rate in sorted(rates)) or "none (arrays need fps=…)"
        raise UsageError(f"motions at one framerate are compared, these have {found}: motion.resample(fps) changes it")
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
