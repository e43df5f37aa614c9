"""Quality report of a store: flags per source, the worst sequences of each, upsampled sequences."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from motionkit.store.reader import Store
from motionkit.store.schema import SEQUENCES

if TYPE_CHECKING:
    import pandas as pd

WORST = 5


@dataclass(frozen=True)
class FlagCount:
    """Number of sequences with a flag, and their total duration."""

    num_sequences: int
    hours: float


@dataclass(frozen=True)
class SourceQuality:
    """One source's sequences; `flags` most frequent first, `clean` those without any, `num_unmeasured` those that a
    store of an older format version holds.
    """

    source: str
    num_sequences: int
    hours: float
    clean: FlagCount
    flags: dict[str, FlagCount]


@dataclass(frozen=True)
class Offender:
    """A flagged sequence: the figure that the flag is about, and where in the sequence (None: all of it)."""

    sequence_id: str
    value: float
    seconds: float | None
    frame: int | None


@dataclass(frozen=True)
class WorstOf:
    """The worst sequences with a flag; `column` and `unit` describe their values."""

    flag: str
    column: str
    unit: str
    offenders: tuple[Offender, ...]


@dataclass(frozen=True)
class Upsampled:
    """A sequence whose frames show a lower framerate than stated."""

    sequence_id: str
    stated_fps: str
    fps: float
    effective_fps: float


@dataclass(frozen=True)
class QualityReport:
    """The report of `motionkit info --quality`."""

    store: str
    where: str | None
    num_sequences: int
    sources: tuple[SourceQuality, ...]
    worst: tuple[WorstOf, ...]
    upsampled: tuple[Upsampled, ...]


@dataclass(frozen=True)
class _Figure:
    column: str
    unit: str
    place: str | None = None
    badness: "Callable[[pd.Series], pd.Series]" = lambda values: values


# Each flag's figure: its column, and the column of its location.
FIGURES = {
    "teleport": _Figure("num_teleports", "jumps", "first_teleport_seconds"),
    "joint_speed": _Figure("max_joint_speed_metres_per_second", "m/s"),
    "jitter": _Figure("jitter_metres_per_second_cubed", "m/s³"),
    "frozen": _Figure("frozen_seconds", "s", "frozen_start_seconds"),
    "foot_skate": _Figure("foot_skate_metres_per_second", "m/s"),
    "floor_height": _Figure("floor_height_metres", "m", badness=lambda heights: heights.abs()),
    "bone_length": _Figure("bone_length_drift", "of its length"),
}


def report_quality(store: Store, where: str | None = None) -> QualityReport:
    """Add up the quality columns of the sequences for which `where` (SQL) holds; raises `UsageError` for bad SQL."""
    # All columns except text, which takes most of a whole table's memory.
    columns = [name for name in SEQUENCES.names if name not in ("captions", "operations")]
    rows = store.columns(*columns).loc[store.select(where)]
    return QualityReport(
        store=str(store.path),
        where=where,
        num_sequences=len(rows),
        sources=tuple(_source(str(source), group) for source, group in rows.groupby("source", sort=True)),
        worst=tuple(found for flag, figure in FIGURES.items() if (found := _worst(rows, flag, figure)).offenders),
        upsampled=_upsampled(rows),
    )


def _source(source: str, rows: "pd.DataFrame") -> SourceQuality:
    import pandas as pd

    flags = rows["quality_flags"].explode()
    held = pd.DataFrame({"flag": flags, "seconds": rows["duration_seconds"].reindex(flags.index)})
    counted = held.groupby("flag")["seconds"].agg(["size", "sum"]).sort_values("size", ascending=False, kind="stable")
    clean = rows["quality_flags"].map(len) == 0
    return SourceQuality(
        source=source,
        num_sequences=len(rows),
        hours=_hours(rows),
        clean=FlagCount(int(clean.sum()), _hours(rows[clean])),
        flags={
            str(flag): FlagCount(int(size), float(seconds) / 3600)
            for flag, size, seconds in zip(counted.index, counted["size"], counted["sum"], strict=True)
        },
    )


def _hours(rows: "pd.DataFrame") -> float:
    return float(rows["duration_seconds"].sum()) / 3600


def _flagged(rows: "pd.DataFrame", flag: str) -> "pd.DataFrame":
    return rows[rows["quality_flags"].map(lambda flags: flag in flags).astype(bool)]


def _worst(rows: "pd.DataFrame", flag: str, figure: _Figure) -> WorstOf:
    flagged = _flagged(rows, flag)
    order = figure.badness(flagged[figure.column]).sort_values(ascending=False, kind="stable").index[:WORST]
    return WorstOf(flag, figure.column, figure.unit, tuple(_offender(flagged.loc[row], figure) for row in order))


def _offender(row: "pd.Series", figure: _Figure) -> Offender:
    seconds = None if figure.place is None else float(row[figure.place])
    frame = None if seconds is None else round(seconds * float(row["fps"]))
    return Offender(str(row["sequence_id"]), float(row[figure.column]), seconds, frame)


def _upsampled(rows: "pd.DataFrame") -> tuple[Upsampled, ...]:
    found = _flagged(rows, "upsampled")
    return tuple(
        Upsampled(str(sequence_id), str(stated), float(fps), float(effective))
        for sequence_id, stated, fps, effective in zip(
            found["sequence_id"], found["stated_fps"], found["fps"], found["effective_fps"], strict=True
        )
    )
