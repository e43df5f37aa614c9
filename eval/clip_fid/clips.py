"""Random clips of a sample set, and the interface of the features computed on them."""

import typing
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np

from eval.metrics.number import RESAMPLINGS
from eval.sets.sets import Ragged, SampleSet
from motionkit.core.errors import MotionkitError
from motionkit.core.shapes import Float, Float64, Int64

REAL, OTHER = 0, 1
"""The two sides of a comparison: each draws its own sequences."""


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

    def describe(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """One row per clip, in order; positions in metres, y up, the 22 joints of `SMPL22`."""
        ...


@typing.runtime_checkable
class MotionFeatures(FeatureSet, typing.Protocol):
    """A feature set computed on whole motions before clips are cut: clips are cut from the output of `frames`."""

    def frames(self, samples: SampleSet) -> Ragged:
        """One row of numbers for every row of the samples' sequences."""
        ...


class ClipError(MotionkitError):
    """A sample set that is too short for the requested clips."""


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


DETAILED_COST = 30
"""How many plain replications take as long as one with KID and PRDC (40 rows of 4,096 clips on two cores)."""


@dataclass(frozen=True)
class Protocol:
    """Number and sizes of clips, and replications; `detailed_replications` of them also get KID and PRDC.

    `resamplings` is the number of bootstrap samples over takes for the interval; with 0 it covers clip sampling only.
    """

    sizes: PoseRange | SecondsRange = field(default_factory=PoseRange)
    num_clips: int = 4096
    replications: int = 20
    detailed_replications: int = 3
    num_neighbours: int = 5
    seed: int = 0
    resamplings: int = RESAMPLINGS

    def costs(self, num_rows: int) -> list[int]:
        """About what each replication of so many rows takes, then each split into halves, beside one plain split."""
        each = [DETAILED_COST if number < self.detailed_replications else 1 for number in range(self.replications)]
        return [*(num_rows * cost for cost in each), *each]


@dataclass(frozen=True, eq=False)
class ClipList:
    """Clips independent of a sample set: sizes m, and quantiles in [0, 1) of centre v and of sequence."""

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

    If sequences were shared too, a copy of the real set would score 0 instead of the sampling floor.
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
    """Cut the clips from a set's sequences (only `among`, if given), drawn in proportion to their duration.

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


def readable(samples: SampleSet, features: FeatureSet) -> SampleSet:
    """The sample set with the features' input per pose: positions, or the feature set's own rows."""
    if not isinstance(features, MotionFeatures) or samples.sequences.values.ndim != 3:  # or they are read already
        return samples
    return replace(samples, sequences=features.frames(samples), local_rotations=None)


def describe_clips(
    samples: SampleSet, places: ClipPlaces, features: FeatureSet
) -> Float64[np.ndarray, "clips features"]:
    """Features of clips of the output of `readable`, in the order of the places, batched by size."""
    order = np.argsort(places.num_poses, kind="stable")
    sizes, starts = np.unique(places.num_poses[order], return_index=True)
    parts = [
        features.describe(samples.sequences.clips(places.first_row[rows], int(size)), samples.fps)
        for size, rows in zip(sizes, np.split(order, starts[1:]), strict=True)
    ]
    result = np.empty((len(order), parts[0].shape[1]))
    result[order] = np.concatenate(parts)
    return result
