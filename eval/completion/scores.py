"""Scores of a row: means by metric and column, and the scaling of pose vectors."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np

from eval.completion.takes import TrueClips
from eval.metrics.metric import MeanStream, MeanSums, find_metric
from eval.metrics.motion import to_unit_range
from eval.metrics.number import Number, with_takes
from eval.metrics.resampling import Resampling
from motionkit.core.moments import stream
from motionkit.core.shapes import Bool, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.features import rotations

# Sums of every take, so that takes can be resampled, and pooled with those of other data sets.
TakeSums = Mapping[str, MeanSums]


def mean_over_takes(takes: TakeSums) -> Number:
    """The mean over clips, frames or true power, with its interval over takes; none for a single take."""
    mean = reduce(MeanSums.merged, takes.values()).mean
    if len(takes) < 2:
        return Number(mean)
    weights = Resampling().weights([f"take {take}" for take in takes])
    totals, sizes = (weights @ [getattr(sums, name) for sums in takes.values()] for name in ("total", "weight"))
    pairs = zip(totals.tolist(), sizes.tolist(), strict=True)
    return with_takes(mean, tuple(total / size if size else None for total, size in pairs))


# By metric, then by column (a scale, a length).
Scores = Mapping[str, Mapping[str, TakeSums]]


def to_plain(scores: Scores) -> dict[str, dict[str, dict[str, list[float]]]]:
    """Scores as plain values: the sums of every take."""
    return {
        metric: {
            column: {take: [sums.total, sums.weight] for take, sums in takes.items()}
            for column, takes in columns.items()
        }
        for metric, columns in scores.items()
    }


def from_plain(values: Mapping[str, Mapping[str, Mapping[str, Sequence[float]]]]) -> Scores:
    """Inverse of `to_plain`."""
    return {
        metric: {column: {take: MeanSums(*sums) for take, sums in takes.items()} for column, takes in columns.items()}
        for metric, columns in values.items()
    }


class TakeStreams:
    """Accumulates metrics per take."""

    def __init__(self, metrics: Sequence[str]) -> None:
        self._metrics = metrics
        self._of_take: dict[str, dict[str, MeanStream]] = {}

    def by_take(self, takes: Sequence[str]) -> Iterator[tuple[Int64[np.ndarray, "_clips"], Mapping[str, MeanStream]]]:
        """The clips of every take of a batch, and the streams by metric that they are for."""
        for take in dict.fromkeys(takes):
            if take not in self._of_take:
                self._of_take[take] = {name: MeanStream(find_metric(name)) for name in self._metrics}
            yield np.array([place for place, each in enumerate(takes) if each == take]), self._of_take[take]

    def means(self, metric: str) -> TakeSums:
        """The accumulated sums of a metric."""
        return {take: streams[metric].sums for take, streams in self._of_take.items()}


def scores_of(streams: Mapping[str, TakeStreams], metrics: Sequence[str]) -> Scores:
    """The accumulated sums by column."""
    return {name: {column: of_column.means(name) for column, of_column in streams.items()} for name in metrics}


def pooled(groups: Sequence[Mapping[str, Scores]]) -> dict[str, Scores]:
    """Scores of all groups' clips together, for the rows that every group has; rows in the first group's order."""
    first, *others = groups
    return {
        name: reduce(_joined, (group[name] for group in groups))
        for name in first
        if all(name in group for group in others)
    }


def _joined(first: Scores, second: Scores) -> Scores:
    return {
        metric: {column: _with_takes_of(sums, second[metric][column]) for column, sums in columns.items()}
        for metric, columns in first.items()
    }


def _with_takes_of(first: TakeSums, second: TakeSums) -> TakeSums:
    return {**first, **{take: first[take].merged(sums) if take in first else sums for take, sums in second.items()}}


ROOT_PATH, ROOT_HEIGHT, ROOT_ROTATION, JOINT_ROTATIONS = slice(0, 3, 2), slice(1, 2), slice(3, 9), slice(9, None)
GROUPS = (ROOT_PATH, ROOT_HEIGHT, ROOT_ROTATION, JOINT_ROTATIONS)
# Deviations are at least this share of their group's: otherwise the noise of joints that hardly turn would count as
# much as a leg's swing.
FLOOR_SHARE = 0.25
# A smaller deviation is float32 rounding: a leaf of the skeleton, which has no bone to rotate.
CONSTANT = 1e-5
CLIPS_AT_ONCE = 512


@dataclass(frozen=True, eq=False)
class PoseScale:
    """Mean and deviation of the numbers that vary; the others are ignored."""

    mean: Float64[np.ndarray, "numbers"]
    std: Float64[np.ndarray, "numbers"]
    varies: Bool[np.ndarray, "all_numbers"]

    def unit_range(
        self, vectors: Float32[np.ndarray, "clips frames all_numbers"]
    ) -> Float64[np.ndarray, "clips frames numbers"]:
        """0.5 + (x − μ)/(4σ) of the numbers that vary."""
        return to_unit_range(vectors[..., self.varies], self.mean, self.std)


@dataclass(frozen=True, eq=False)
class ClipFrames:
    """The clips' own frames: origin under the root at the first frame, which faces Z+."""

    yaw: Float64[np.ndarray, "clips"]
    origin: Float64[np.ndarray, "clips 2"]

    @classmethod
    def of(cls, vectors: Float32[np.ndarray, "clips frames numbers"]) -> "ClipFrames":
        """By the first frame, which is given in every table."""
        return cls(rotations.heading(vectors[:, 0], SMPL22), vectors[:, 0, (0, 2)].astype(np.float64))

    def to_window(
        self, vectors: Float32[np.ndarray, "clips frames numbers"]
    ) -> Float32[np.ndarray, "clips frames numbers"]:
        """World → each clip's own frame."""
        return rotations.to_window(vectors, self.yaw, self.origin)


def measure_scale(clips: TrueClips) -> PoseScale:
    """Mean and deviation of all frames of training clips, each clip in its own frame.

    The root's x and z share a deviation; a number has at least a quarter of its group's (root mean square over those
    that vary). Groups: the root's path, its height, its rotation, the joints' rotations.
    """
    parts = (slice(first, first + CLIPS_AT_ONCE) for first in range(0, clips.num_clips, CLIPS_AT_ONCE))
    found = stream(_rows(clips, part) for part in parts)
    variance = found.std**2
    varies = variance > CONSTANT**2
    variance[ROOT_PATH] = variance[ROOT_PATH].mean()
    for group in GROUPS:
        present = variance[group][varies[group]]
        if present.size:
            variance[group] = np.maximum(variance[group], FLOOR_SHARE**2 * present.mean())
    return PoseScale(found.mean[varies], np.sqrt(variance[varies]), varies)


def _rows(clips: TrueClips, part: slice) -> Float32[np.ndarray, "rows numbers"]:
    vectors = clips.vectors(part)
    own = ClipFrames.of(vectors).to_window(vectors)
    return own.reshape(-1, own.shape[-1])


if TYPE_CHECKING:
    from motionkit.store.reader import Store


def split_remark(store: "Store", clips: TrueClips, split: str) -> str:
    """A remark on the performers of these clips, and how many of them are in the training split too."""
    rows = store.columns("source", "subject", "split")
    chosen = rows.loc[sorted(set(clips.sequence_index.tolist()))]
    if (chosen["subject"] == "").all():
        return "the store does not name performers, so the same people may be in the training split."
    performers = set(zip(chosen["source"], chosen["subject"], strict=True))
    training = rows[rows["split"] == "train"]
    shared = performers & set(zip(training["source"], training["subject"], strict=True))
    if not shared:
        return f"{len(performers)} performers, none of whom is in the training split."
    return (
        f"{len(performers)} performers, {len(shared)} of whom are in the training split too, with other takes "
        "(motionkit split holds out whole performers)."
    )
