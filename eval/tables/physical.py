"""Physical plausibility of real motion, a run's models and samples, by metrics that do not depend on the framerate.

Published metrics are shown beside them, by name and as their projects compute them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.metrics.metric import Metric, find_metric
from eval.metrics.number import Number, with_takes
from eval.metrics.physical import METRICS, ground_height
from eval.metrics.physical_published import METRICS as PUBLISHED
from eval.metrics.resampling import Resampling, Units, units_of
from eval.report.differences import differences_block, of_interest, pairs_of
from eval.report.results import Block, Result, Row, cell_of, measure
from eval.sets.generated import sample_fields
from eval.sets.partial import PartialResult, collect
from eval.sets.real import NoRealMotionError, RealMotion, real_motion
from eval.sets.row_ids import REAL, RowId, Variant
from eval.sets.sets import SampleSet
from eval.tables.models import generated_fields
from eval.tables.nerm.clip_fid_column import NOT_SO_FAST, ModelFields, framerate_label, samples_at
from eval.tables.registry import Table, TableRequest
from motionkit.core.progress import task
from motionkit.core.shapes import Float64
from motionkit.generate.models import installed_models

VERSION = "physical/1"
COLUMNS = (Fraction(20), Fraction(120))
SKATING = find_metric("slide_speed").title
# Published metrics that do not depend on the framerate, as they are per instant.
PER_INSTANT = ("physdiff_penetrate", "physdiff_float")
OURS = (*METRICS[:4], *(find_metric(name) for name in PER_INSTANT), *METRICS[4:])
PER_FRAME = tuple(metric for metric in PUBLISHED if metric.name not in PER_INSTANT)
NOTE = (
    "Of each motion by itself, with its floor (its lowest joint is lower for 5 % of the time) at 0; a row is the mean "
    "over its motions, weighing by their seconds, ± half its 95 % interval over takes. No figure stands for itself: a "
    "frozen body doesn't skate (docs/results/physical.md)."
)
PUBLISHED_NOTE = (
    "As their projects compute them, on the same motions with the same floor. All but Kimodo's count per frame, and "
    "Kimodo's see a capture's noise at high framerates: numbers of two framerates don't compare."
)


@dataclass(frozen=True, eq=False)
class Measured:
    """Every metric of every motion of a set, NaN if a motion has nothing to measure.

    `seconds` are the motions' durations, `units` their takes for the bootstrap.
    """

    values: Mapping[str, Float64[np.ndarray, "motions"]]
    seconds: Float64[np.ndarray, "motions"]
    units: Units

    def mean(self, metric: Metric, resampling: Resampling) -> Number | None:
        """The mean over motions, weighted by seconds; None if none has the metric."""
        values = self.values[metric.name]
        seconds = np.where(np.isfinite(values), self.seconds, 0.0)
        if not seconds.any():
            return None
        sums = [np.bincount(self.units.unit, each) for each in (seconds * np.nan_to_num(values), seconds)]
        totals, counts = (self.units.weights(resampling) @ each for each in sums)
        resampled = tuple(float(total / count) if count else None for total, count in zip(totals, counts, strict=True))
        return with_takes(float(sums[0].sum() / sums[1].sum()), resampled)


def floors_of(samples: SampleSet) -> list[float]:
    """The floor height of every motion in metres."""
    return [ground_height(positions, samples.fps) / 1000.0 for positions in samples.sequences]


def measured(
    samples: SampleSet, on_motion: Callable[[], None] = lambda: None, *, floors: Sequence[float] | None = None
) -> Measured:
    """Measure every motion of a set, over its own floor unless `floors` are given; `on_motion` is called after each."""
    found: dict[str, list[float]] = {metric.name: [] for metric in (*OURS, *PER_FRAME)}
    fps = float(samples.fps)
    for positions, floor in zip(samples.sequences, floors or floors_of(samples), strict=True):
        for metric in METRICS:
            found[metric.name].append(_number(metric.function(positions, samples.fps)))
        for metric in PUBLISHED:
            found[metric.name].append(_number(metric.function(positions, fps, floor=floor)))
        on_motion()
    values = {name: np.array(each) for name, each in found.items()}
    return Measured(values, samples.sequences.num_frames / fps, units_of(samples.take_names, samples.generations))


def _number(value: object) -> float:
    # Rounding errors leave 1e-17 instead of 0.
    return round(value, 12) if isinstance(value, float) else np.nan


def build_physical(request: TableRequest) -> Result:
    """Every available row at each framerate.

    Raises `UsageError` or `StoreError` for a store that cannot be used, and `NoRealMotionError` if no column has
    real motion.
    """
    store = request.open_store()
    folders = request.sample_folders
    real = real_motion(store, request.real.split, request.real.where)
    rates = collect(request.fps or COLUMNS, real.indices_at, framerate_label, (NoRealMotionError,))
    if not rates.value:
        raise NoRealMotionError(rates.missing[-1])
    generated = generated_fields(request, real.at(min(rates.value)))
    fields = generated.value.rows
    blocks: list[Block] = []
    slow: list[str] = []
    for fps in rates.value:
        sets = _sets(fps, real, fields, request)
        blocks += _blocks(fps, sets.value, generated.value.training, request)
        slow += sets.missing
        real.forget_all_but(min(rates.value))
    return Result(
        task="physical",
        version=VERSION,
        title="Feet, floor and roughness",
        caption=f"Physical figures of real motion, {request.real.named}, and of what was made for it.",
        blocks=tuple(blocks),
        definition={"split": request.real.split, "where": request.real.where, "version": VERSION},
        notes=tuple(f"{folder.name}: {folder.describe()}" for folder in folders),
        missing=(*rates.missing, *generated.missing, *slow),
        provenance=request.provenance(
            store,
            run=request.evaluated.run.name if request.evaluated.run and fields else None,
            samples={folder.name: folder.fingerprint for folder in folders},
        ),
    )


TABLE = Table("nerm", "physical", "feet, floor and roughness", build_physical, shown=installed_models)


def _sets(
    fps: Fraction, real: RealMotion, fields: ModelFields, request: TableRequest
) -> PartialResult[dict[RowId, SampleSet]]:
    """The rows' motions at one framerate, for its real takes."""
    reference = real.at(fps)
    samples = samples_at(request.sample_folders, real, fps, request.on_progress)
    generated = {row: sample_fields(own, reference.sequence_ids, fps, str(row)) for row, own in fields.items()}
    made = {row: found for row, found in generated.items() if found is not None}
    slow = (f"{row}, {framerate_label(fps)}: {NOT_SO_FAST}" for row in generated if row not in made)
    return PartialResult({REAL: reference, **made, **samples.value}, (*slow, *samples.missing))


def _blocks(
    fps: Fraction, sets: Mapping[RowId, SampleSet], training: Mapping[str, str], request: TableRequest
) -> list[Block]:
    """The blocks of our and the published metrics, at one framerate."""
    rows: dict[RowId, Measured] = {}
    notes: dict[RowId, str] = {}
    for row, samples in sets.items():
        with task(request.on_progress, f"{row}, {framerate_label(fps)}", samples.num_sequences) as work:
            rows[row] = measured(samples, work.advance)
        trained = training.get(row.system) if row.variant is Variant.AS_IS else None
        notes[row] = "; ".join(filter(None, (_size(samples), trained)))
    label = framerate_label(fps)
    return [
        *blocks_of(f"Per second, at {label}", OURS, rows, notes, NOTE, request.seed),
        *blocks_of(f"By the field's definitions, at {label}", PER_FRAME, rows, notes, PUBLISHED_NOTE, request.seed),
    ]


def blocks_of(
    title: str,
    metrics: Sequence[Metric],
    rows: Mapping[RowId, Measured],
    notes: Mapping[RowId, str],
    note: str,
    seed: int,
) -> list[Block]:
    """A block with a column for each metric that some row has, and the rows' differences; `REAL` is the reference."""
    means = {row: _means(metrics, found, Resampling(seed=seed)) for row, found in rows.items()}
    shown = [metric for metric in metrics if any(metric.title in row for row in means.values())]
    columns = tuple(metric.title for metric in shown)
    measures = tuple(measure(metric, column=metric.title) for metric in shown)
    found = tuple(
        Row(
            str(row),
            "reference" if row == REAL else "ours",
            {column: cell_of(mean) for column, mean in by_column.items()},
            notes[row],
        )
        for row, by_column in means.items()
    )
    pairs = pairs_of((row for row in means if row != REAL), (REAL,))
    paired = {
        (first, second): {
            column: difference
            for column, mean in means[first].items()
            if column in means[second] and (difference := mean.less(means[second][column])) is not None
        }
        for first, second in pairs
    }
    block = Block(title, columns, found, note=note, metrics=measures)
    differences = differences_block(block, of_interest(block, paired, _nearest(means)))
    return [block, *([differences] if differences else [])]


def _nearest(means: Mapping[RowId, Mapping[str, Number]]) -> list[str]:
    """The row with the foot skating nearest to real motion's; none for blocks without that column."""
    speeds = {row: by_column[SKATING].value for row, by_column in means.items() if SKATING in by_column}
    real = speeds.pop(REAL, None)
    return [] if real is None else [str(row) for row in sorted(speeds, key=lambda row: abs(speeds[row] - real))[:1]]


def _means(metrics: Sequence[Metric], row: Measured, resampling: Resampling) -> dict[str, Number]:
    """A row's means by column."""
    found = {metric.title: row.mean(metric, resampling) for metric in metrics}
    return {title: mean for title, mean in found.items() if mean is not None}


def _size(samples: SampleSet) -> str:
    """Number of motions and takes of a row, and their duration."""
    return f"{samples.num_takes} takes, {samples.num_sequences} motions, {samples.duration_seconds:.0f} s"
