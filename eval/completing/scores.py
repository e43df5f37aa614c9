"""What a row scores: means by metric and by column, which can be joined with those of other clips."""

from collections.abc import Mapping, Sequence
from functools import reduce

from eval.metrics.registry import MeanStream
from eval.metrics.streaming import MeanSums

# By metric, then by what was asked (a scale, a length). All these metrics are means over clips, frames or true power,
# so their sums over several data sets are those of all clips together.
Scores = Mapping[str, Mapping[str, MeanSums]]


def scores_of(streams: Mapping[str, Mapping[str, MeanStream]], metrics: Sequence[str]) -> Scores:
    """What the streams have seen; they are by column, then by metric."""
    return {name: {column: of_column[name].sums for column, of_column in streams.items()} for name in metrics}


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
        metric: {column: sums.merged(second[metric][column]) for column, sums in columns.items()}
        for metric, columns in first.items()
    }
