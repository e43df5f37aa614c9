"""clip-FID as this project defines it: Fréchet distance between features of random native-rate clips.

The NeRM paper (§4.2) compares random clips of m poses at framerate s around a centre v, real against generated, without
resampling either; m, the number of clips, the extractor and the real set at a target rate are this project's choices,
and `VERSION` is raised whenever one of them changes. Not to be mistaken for the FID of images on CLIP features that
other tools call clip-FID.
"""

import os
import typing
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
import numpy.typing as npt
from jaxtyping import Float, Float64, Int64

from eval.metrics.checks import Estimate, estimate
from eval.metrics.gaussian import fid_infinity, fit_gaussian, frechet_distance, kid
from eval.metrics.metric import Metric
from eval.metrics.neighbours import prdc
from eval.sets.sets import SampleSet
from motionkit.core.errors import MotionkitError

VERSION = "clip-fid/1"
PART = "part "
REAL, OTHER = 0, 1
"""The two sides of a comparison: each draws its own sequences."""


@typing.runtime_checkable
class FeatureSet(typing.Protocol):
    """What is needed of a feature extractor, learned or not: it turns clips of one framerate into feature vectors.

    The same clips give the same numbers in any batch.
    """

    @property
    def name(self) -> str:
        """Name for tables."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash of everything that the numbers depend on: definition, weights, statistics."""
        ...

    def describe(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """One row per clip, in order; positions in metres, y up, the 22 joints of `SMPL22`."""
        ...


class ClipError(MotionkitError):
    """A sample set from which the clips that were asked for cannot be cut."""


@dataclass(frozen=True)
class PoseRange:
    """Clip sizes m: multiples of `multiple` poses from `minimum` to `maximum`, the same at every framerate."""

    minimum: int = 16
    maximum: int = 64
    multiple: int = 4

    def sizes(self, fps: Fraction) -> Int64[np.ndarray, "sizes"]:
        """Numbers of poses, each equally likely."""
        first = -(-self.minimum // self.multiple) * self.multiple
        return np.arange(first, self.maximum + 1, self.multiple, dtype=np.int64)


@dataclass(frozen=True)
class SecondsRange:
    """Clip sizes between two durations in seconds, in multiples of `multiple` poses: m grows with the framerate."""

    minimum: float
    maximum: float
    multiple: int = 4

    def sizes(self, fps: Fraction) -> Int64[np.ndarray, "sizes"]:
        """Numbers of poses, each equally likely. Raises `ClipError` where no multiple lies between the durations."""
        first = int(np.ceil(self.minimum * float(fps) / self.multiple)) * self.multiple
        sizes = np.arange(first, int(self.maximum * float(fps)) + 1, self.multiple, dtype=np.int64)
        if not sizes.size:
            raise ClipError(
                f"no multiple of {self.multiple} poses lasts {self.minimum} … {self.maximum} s at {fps} fps; widen the "
                "range"
            )
        return sizes


@dataclass(frozen=True)
class Protocol:
    """How many clips, of which sizes, how often; `detailed_replications` of them also get KID and PRDC."""

    sizes: PoseRange | SecondsRange = field(default_factory=PoseRange)
    num_clips: int = 4096
    replications: int = 20
    detailed_replications: int = 3
    num_neighbours: int = 5
    seed: int = 0


@dataclass(frozen=True, eq=False)
class ClipList:
    """Clips before they meet a sample set: sizes m, and quantiles in [0, 1) of centre v and of sequence."""

    num_poses: Int64[np.ndarray, "clips"]
    centre_quantile: Float64[np.ndarray, "clips"]
    sequence_quantile: Float64[np.ndarray, "clips"]


@dataclass(frozen=True, eq=False)
class ClipPlaces:
    """Clips of one sample set: first row and number of poses of each, and its sequence."""

    sequence: Int64[np.ndarray, "clips"]
    first_row: Int64[np.ndarray, "clips"]
    num_poses: Int64[np.ndarray, "clips"]


def check_lengths(samples: SampleSet, protocol: Protocol) -> None:
    """Raise `ClipError` where a set has no sequence for the protocol's largest clips."""
    largest, longest = int(protocol.sizes.sizes(samples.fps).max()), int(samples.sequences.num_frames.max())
    if longest < largest:
        raise ClipError(
            f"{samples.name}: no sequence has the {largest} poses that a clip at {samples.fps} fps may need; the "
            f"longest has {longest}; lower the largest clip size or give longer motions"
        )


def draw_clips(protocol: Protocol, fps: Fraction, replication: int, side: int) -> ClipList:
    """The clip list of one replication: both sides share sizes and centres; each side draws its own sequences.

    Were the sequences shared too, a copy of the real set would score 0 instead of the floor that sampling leaves.
    """
    stream = (protocol.seed, fps.numerator, fps.denominator, replication)
    shared = np.random.default_rng((*stream, 0))
    own = np.random.default_rng((*stream, 1 + side))
    return ClipList(
        num_poses=shared.choice(protocol.sizes.sizes(fps), size=protocol.num_clips),
        centre_quantile=shared.random(protocol.num_clips),
        sequence_quantile=own.random(protocol.num_clips),
    )


def place_clips(clips: ClipList, samples: SampleSet, among: Int64[np.ndarray, "chosen"] | None = None) -> ClipPlaces:
    """Cut the clips from a set's sequences (those `among`, where given), drawn in proportion to their duration.

    Only sequences that hold the whole clip are drawn from; the centre is uniform over the positions on the frame grid.
    Raises `ClipError` where no sequence is long enough.
    """
    sequences = np.arange(samples.num_sequences) if among is None else among
    num_frames = samples.sequences.num_frames[sequences]
    chosen = np.empty_like(clips.num_poses)
    for size in np.unique(clips.num_poses).tolist():
        wanted = clips.num_poses == size
        weight = np.cumsum(np.where(num_frames >= size, num_frames, 0))
        if not len(weight) or weight[-1] == 0:
            raise ClipError(f"{samples.name}: no sequence among {len(sequences)} has {size} poses at {samples.fps} fps")
        chosen[wanted] = np.searchsorted(weight, clips.sequence_quantile[wanted] * weight[-1], side="right")
    room = num_frames[chosen] - clips.num_poses + 1
    start = np.floor(clips.centre_quantile * room).astype(np.int64)
    sequence = sequences[chosen]
    return ClipPlaces(sequence, samples.sequences.start_row[sequence] + start, clips.num_poses)


def describe_clips(
    samples: SampleSet, places: ClipPlaces, features: FeatureSet
) -> Float64[np.ndarray, "clips features"]:
    """Features of placed clips, in the order of the places; clips are handed over in groups of one size."""
    order = np.argsort(places.num_poses, kind="stable")
    sizes, starts = np.unique(places.num_poses[order], return_index=True)
    parts = [
        features.describe(samples.sequences.clips(places.first_row[rows], int(size)), samples.fps)
        for size, rows in zip(sizes, np.split(order, starts[1:]), strict=True)
    ]
    result = np.empty((len(order), parts[0].shape[1]))
    result[order] = np.concatenate(parts)
    return result


@dataclass(frozen=True)
class ClipFid:
    """One comparison: clip-FID, the FID of named parts of the features, and further metrics on the same features.

    `details` holds fid_infinity, kid, precision, recall, density and coverage; it is empty where the protocol asks for
    no detailed replications, and has no fid_infinity where there are too few clips to extrapolate from.
    """

    clip_fid: Estimate
    parts: Mapping[str, Estimate]
    details: Mapping[str, Estimate]


Scores = dict[str, float]


def score_rows(
    real: SampleSet,
    rows: Mapping[str, SampleSet],
    features: FeatureSet,
    protocol: Protocol,
    parts: Mapping[str, slice] | None = None,
    on_replication: Callable[[], None] = lambda: None,
) -> dict[str, ClipFid]:
    """clip-FID of every row's sample set against the real one at the same framerate.

    `parts` names slices of the features whose own FID is wanted; `on_replication` is called after each replication.
    Raises `ClipError` where clips do not fit or the real set's features are constant, and `ValueError` where framerates
    differ.
    """
    for samples in rows.values():
        if samples.fps != real.fps:
            raise ValueError(f"{samples.name} is at {samples.fps} fps, the real set at {real.fps}")

    def replicate(replication: int) -> dict[str, Scores]:
        reference = _features(real, features, protocol, replication, REAL)
        if (reference == reference[0]).all():
            raise ClipError(
                f"{real.name} at {real.fps} fps: every clip has the same {features.name} features, so there is no "
                "distribution to compare with; is the motion frozen?"
            )
        scores = {}
        for name, samples in rows.items():
            described = _features(samples, features, protocol, replication, OTHER)
            scores[name] = _compare(reference, described, protocol, replication, parts or {})
        return scores

    replications = _run(replicate, protocol.replications, on_replication)
    return {name: _summarise([scores[name] for scores in replications]) for name in rows}


CLIP_FID = Metric(
    "clip_fid",
    "clip-FID",
    "",
    False,
    f"NeRM §4.2, as {VERSION}",
    "real, generated",
    score_rows,
    calibration="motionkit eval --calibrate",
)


def score_disjoint_halves(
    real: SampleSet,
    features: FeatureSet,
    protocol: Protocol,
    parts: Mapping[str, slice] | None = None,
    on_replication: Callable[[], None] = lambda: None,
) -> ClipFid:
    """clip-FID between disjoint halves of the real takes (P2), split anew in every replication: the honest floor."""

    def replicate(replication: int) -> dict[str, Scores]:
        halves = _split_takes(real, np.random.default_rng((protocol.seed, replication, 3)))
        a, b = (
            _features(real, features, protocol, replication, side, half)
            for side, half in zip((REAL, OTHER), halves, strict=True)
        )
        return {"halves": _compare(a, b, protocol, replication, parts or {})}

    return _summarise([scores["halves"] for scores in _run(replicate, protocol.replications, on_replication)])


def _run(
    replicate: Callable[[int], dict[str, Scores]], replications: int, on_replication: Callable[[], None]
) -> list[dict[str, Scores]]:
    """Run replications on as many threads as there are processors (numpy releases the interpreter's lock).

    The linear algebra library gets one thread in each: its own threads would only get in their way.
    """
    from threadpoolctl import threadpool_limits

    results = []
    workers = max(1, min(os.cpu_count() or 1, replications))
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(max_workers=workers) as pool:
        for scores in pool.map(replicate, range(replications)):
            results.append(scores)
            on_replication()
    return results


def _features(
    samples: SampleSet,
    features: FeatureSet,
    protocol: Protocol,
    replication: int,
    side: int,
    among: Int64[np.ndarray, "chosen"] | None = None,
) -> Float64[np.ndarray, "clips features"]:
    clips = draw_clips(protocol, samples.fps, replication, side)
    return describe_clips(samples, place_clips(clips, samples, among), features)


def _split_takes(samples: SampleSet, rng: np.random.Generator) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Two random halves of the sequences, about equal in duration."""
    if samples.num_sequences < 2:
        raise ClipError(f"{samples.name}: {samples.num_sequences} take cannot be split into two halves")
    order = rng.permutation(samples.num_sequences)
    passed = np.cumsum(samples.sequences.num_frames[order])
    middle = int(np.clip(np.searchsorted(passed, passed[-1] / 2) + 1, 1, len(order) - 1))
    return order[:middle], order[middle:]


def _compare(
    real: Float64[np.ndarray, "clips features"],
    other: Float64[np.ndarray, "clips features"],
    protocol: Protocol,
    replication: int,
    parts: Mapping[str, slice],
) -> Scores:
    scores = {"clip_fid": frechet_distance(fit_gaussian(real), fit_gaussian(other))}
    for name, part in parts.items():
        scores[PART + name] = frechet_distance(fit_gaussian(real[:, part]), fit_gaussian(other[:, part]))
    if replication < protocol.detailed_replications:
        rng = np.random.default_rng((protocol.seed, replication, 4))
        neighbours = prdc(real, other, protocol.num_neighbours)
        # Clips that are no more than four times the features have no such limit.
        with suppress(ValueError):
            scores["fid_infinity"] = fid_infinity(real, other, rng).limit
        scores["kid"] = kid(real, other)
        scores |= {"precision": neighbours.precision, "recall": neighbours.recall}
        scores |= {"density": neighbours.density, "coverage": neighbours.coverage}
    return scores


def _summarise(replications: list[Scores]) -> ClipFid:
    means = {key: estimate([scores[key] for scores in replications if key in scores]) for key in replications[0]}
    total = means.pop("clip_fid")
    parts = {key.removeprefix(PART): means.pop(key) for key in list(means) if key.startswith(PART)}
    return ClipFid(total, parts, means)
