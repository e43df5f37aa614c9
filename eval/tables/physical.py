"""Physical plausibility of real motion, a run's models and samples, by metrics that do not depend on the framerate.

Published metrics are shown beside them, by name and as their projects compute them.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.metrics.intervals import Number, Units, quotients, units_of, with_takes
from eval.metrics.metric import Metric
from eval.metrics.physical import METRICS, ground_height
from eval.metrics.physical_published import METRICS as PUBLISHED
from eval.metrics.registry import find_metric
from eval.report.results import Block, Row, cell_of, measure, score_differences, with_differences
from eval.sets.motions import NoRealMotionError, real_motion, training_motion
from eval.sets.sets import REAL, RowId, SampleSet, Variant
from eval.tables.systems import Column, detail_blocks, generated_at, generated_fields, label, real_column, samples_at
from eval.tables.table import Content, EvalConfig, Table
from motionkit.core.errors import counted
from motionkit.core.progress import task
from motionkit.core.shapes import Float64
from motionkit.generate.models import installed_models
from motionkit.store.reader import Store

RATES = (Fraction(20), Fraction(120))
SKATING = find_metric("slide_speed").title
# Published metrics that do not depend on the framerate, as they are per instant.
PER_INSTANT = ("physdiff_penetrate", "physdiff_float")
OURS = (*METRICS[:4], *(find_metric(name) for name in PER_INSTANT), *METRICS[4:])
PER_FRAME = tuple(metric for metric in PUBLISHED if metric.name not in PER_INSTANT)
NOTE = "Means over motions, weighing by their seconds, ± half the 95 % interval over takes (docs/metrics.md)."
PUBLISHED_NOTE = "As their projects compute them: numbers of two framerates don't compare."


@dataclass(frozen=True, eq=False)
class Measured:
    """Every metric of every motion of a set, NaN if a motion has nothing to measure.

    `seconds` are the motions' durations, `units` their takes for the bootstrap.
    """

    values: Mapping[str, Float64[np.ndarray, "motions"]]
    seconds: Float64[np.ndarray, "motions"]
    units: Units

    def mean(self, metric: Metric, seed: int = 0) -> Number | None:
        """The mean over motions, weighted by seconds; None if none has the metric."""
        values = self.values[metric.name]
        seconds = np.where(np.isfinite(values), self.seconds, 0.0)
        if not seconds.any():
            return None
        sums = [np.bincount(self.units.unit, each) for each in (seconds * np.nan_to_num(values), seconds)]
        resampled = quotients(*(self.units.weights(seed=seed) @ each for each in sums))
        return with_takes(float(sums[0].sum() / sums[1].sum()), resampled)

    def means(self, metrics: Sequence[Metric], seed: int) -> dict[str, Number]:
        """The mean of every metric that a motion has, by title."""
        means = {metric.title: self.mean(metric, seed) for metric in metrics}
        return {title: mean for title, mean in means.items() if mean is not None}


def floors_of(samples: SampleSet) -> list[float]:
    """The floor height of every motion in metres."""
    return [ground_height(positions, samples.fps) / 1000.0 for positions in samples.sequences]


def measured(
    samples: SampleSet, on_motion: Callable[[], None] = lambda: None, *, floors: Sequence[float] | None = None
) -> Measured:
    """Measure every motion of a set, over its own floor unless `floors` are given; `on_motion` is called after each."""
    by_metric: dict[str, list[object]] = defaultdict(list)
    fps = float(samples.fps)
    for positions, floor in zip(samples.sequences, floors or floors_of(samples), strict=True):
        for metric in METRICS:
            by_metric[metric.name].append(metric.function(positions, samples.fps))
        for metric in PUBLISHED:
            by_metric[metric.name].append(metric.function(positions, fps, floor=floor))
        on_motion()
    # Rounding errors leave 1e-17 instead of 0.
    values = {name: np.round(np.array(each, dtype=np.float64), 12) for name, each in by_metric.items()}
    return Measured(values, samples.sequences.num_frames / fps, units_of(samples.take_names, samples.generations))


def compute(config: EvalConfig, store: Store) -> Content:
    """The metrics of every row that can be computed. Raises `NoRealMotionError` if no framerate has real motion."""
    real = real_motion(store, config.split, config.where)
    train = training_motion(store, real)
    columns: list[Column] = []
    for fps in config.fps or RATES:
        with config.missing.skipping(label(fps), (NoRealMotionError,)):
            columns.append(real_column(fps, real, train))
    if not columns:
        raise NoRealMotionError(config.missing.lines[-1])
    generated, training = generated_fields(config, min(columns, key=lambda column: column.fps).real)
    blocks: list[Block] = []
    for column in columns:
        sets = {REAL: column.real, **generated_at(generated, column.real, column.fps, config.missing)}
        sets |= samples_at(real, column.fps, config)
        rows: dict[RowId, Measured] = {}
        notes: dict[RowId, str] = {}
        for row, samples in sets.items():
            with task(config.on_progress, f"{row}, {label(column.fps)}", samples.num_sequences) as work:
                rows[row] = measured(samples, work.advance)
            trained = training.get(row.system, "") if row.variant is Variant.AS_IS else ""
            size = f"{counted(samples.num_takes, 'take')}, {counted(samples.num_sequences, 'motion')}"
            size += f", {samples.duration_seconds:.0f} s"
            notes[row] = "; ".join(filter(None, (size, trained)))
        for title, metrics, note in (
            ("Per second", OURS, NOTE),
            ("By the field's definitions", PER_FRAME, PUBLISHED_NOTE),
        ):
            means = {row: each.means(metrics, config.seed) for row, each in rows.items()}
            shown = [metric for metric in metrics if any(metric.title in row for row in means.values())]
            block = Block(
                f"{title}, at {label(column.fps)}",
                tuple(metric.title for metric in shown),
                tuple(
                    Row(
                        str(row),
                        "reference" if row == REAL else "ours",
                        {column: cell_of(mean) for column, mean in by_column.items()},
                        notes[row],
                    )
                    for row, by_column in means.items()
                ),
                note=note,
                metrics=tuple(measure(metric, column=metric.title) for metric in shown),
            )
            differences = score_differences(means, {metric.title: metric.title for metric in shown}, (REAL,))
            blocks += with_differences(block, differences, _nearest(means))
        blocks += detail_blocks(column.real, column.train, sets, config)
    return Content(
        caption=f"Physical figures of real motion, {config.real}, and of what was made for it.",
        blocks=blocks,
        notes=tuple(f"{folder.name}: {folder.describe()}" for folder in config.sample_folders),
    )


def _nearest(means: Mapping[RowId, Mapping[str, Number]]) -> list[str]:
    """The row with the foot skating nearest to real motion's; none for blocks without that column."""
    speeds = {row: by_column[SKATING].value for row, by_column in means.items() if SKATING in by_column}
    real = speeds.pop(REAL, None)
    return [] if real is None else [str(row) for row in sorted(speeds, key=lambda row: abs(speeds[row] - real))[:1]]


TABLE = Table(
    *("nerm", "physical", "feet, floor and roughness", "physical/1", compute),
    heading="Feet, floor and roughness",
    shown=installed_models,
    task="physical",
)
