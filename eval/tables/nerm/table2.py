"""NeRM's Table 2: clip-FID at 20, 40, 60, 100 and 120 fps, the detail profile, and copies of training motion."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from fractions import Fraction

import numpy as np
from threadpoolctl import threadpool_limits

from eval.clip_fid.score import CLIP_FID, VERSION, FeatureSource, feature_sources
from eval.metrics.intervals import Number
from eval.report.results import Block, Cell, Row, measure, with_differences
from eval.sets import motions
from eval.sets.sets import REAL, Missing, RowId, SampleSet, Variant
from eval.tables import systems
from eval.tables.table import SOURCES, Content, EvalConfig, Table, name_and_fps, printed_block, reported_figures
from motionkit.core.errors import counted
from motionkit.core.progress import task
from motionkit.generate.models import installed_models
from motionkit.store.reader import Store

UPSAMPLED_NOTE = "the same motions generated at 20 fps, then upsampled like the real ones"
COPIES = "Copies of training motion"
HELD_OUT = RowId(REAL.system, Variant.HELD_OUT)
COPIED = "copied (%)"
SHARES = {"nearest (mm)": 0.0, "5 % (mm)": 0.05, "25 % (mm)": 0.25, "50 % (mm)": 0.5, "95 % (mm)": 0.95}
MAX_COPIES = 60
HELD_OUT_SHARE = 0.01
"""Share of held-out real motion's windows that the limit calls copied."""
COPIES_NOTE = (
    f"Copied are windows of a second that are nearer to training motion, for how much they move, than "
    f"{HELD_OUT_SHARE:.0%} of held-out real motion's. Windows that move less than "
    f"{1000 * motions.STILL_METRES:g} mm are left out. The other columns hold the distance within which that share has "
    f"training motion. A row has at most {MAX_COPIES} motions."
)


@dataclass(eq=False)
class Sheet:
    """One feature set's cells and differences by row and column, its fingerprints by column, and remarks."""

    source: FeatureSource
    cells: dict[RowId, dict[str, Cell]] = field(default_factory=lambda: {row: {} for row in systems.REFERENCES})
    differences: dict[tuple[RowId, RowId], dict[str, Number]] = field(default_factory=dict)
    fingerprints: dict[str, str] = field(default_factory=dict)
    remarks: dict[str, None] = field(default_factory=dict)

    def add(self, column: systems.Column, config: EvalConfig) -> None:
        """Score a column's rows."""
        comparison, name = column.comparison(self.source, config), systems.label(column.fps)
        # Once with all rows, once for the halves.
        steps = 2 * comparison.protocol.replications
        with task(config.on_progress, f"{self.source.name}, {name}", steps) as work:
            cells, differences = systems.score_column(
                comparison, column.rows, config.missing, work.advance, column.subset_sizes
            )
        for row, cell in cells.items():
            self.cells.setdefault(row, {})[name] = cell
        for pair, difference in differences.items():
            self.differences.setdefault(pair, {})[name] = difference
        self.fingerprints[name] = comparison.features.fingerprint
        size, sets = comparison.centre.size, column.rows.values()
        if min(comparison.protocol.num_clips, *(each.num_sequences for each in sets)) <= size:
            self.remarks |= {f"With no more motions or clips than {size} features a covariance is singular.": None}

    def blocks(self, labels: tuple[str, ...], notes: Mapping[RowId, str], config: EvalConfig) -> list[Block]:
        """The scores, and which rows differ."""
        scores = Block(
            self.source.title,
            labels,
            tuple(
                Row(str(row), "reference" if row in systems.REFERENCES else "ours", cells, notes.get(row, ""))
                for row, cells in self.cells.items()
                if cells
            ),
            note=" ".join((self.source.note, *self.remarks)).strip(),
            provenance={
                "fingerprints": self.fingerprints,
                "replications": self.source.protocol(config.clips).replications,
            },
            metrics=(measure(CLIP_FID),),
        )
        return with_differences(scores, self.differences)


def compute(config: EvalConfig, store: Store) -> Content:
    """Compute every possible row, and name those that are not.

    Raises `UsageError` or `StoreError` for a store that cannot be used, and `NoRealMotionError` if no column has
    real motion.
    """
    real = motions.real_motion(store, config.split, config.where)
    train = motions.training_motion(store, real)
    with task(config.on_progress, "real sets"):
        rates: list[Fraction] = []
        for fps in config.fps or systems.COLUMNS:
            with config.missing.skipping(f"{fps} fps", (motions.NoRealMotionError,)):
                real.indices_at(fps)
                rates.append(fps)
    if not rates:
        raise motions.NoRealMotionError(config.missing.lines[-1])
    generated, training = systems.generated_fields(config, real.at(min(rates)))
    notes = _row_notes(training, config)
    sheets = [Sheet(source) for source in feature_sources(config.evaluators, config.guo, config.missing)]
    real_sets: dict[str, dict[str, float]] = {}
    details: list[Block] = []
    for fps in rates:
        # One column's motions at a time: all framerates together need three times the memory.
        column, name = systems.make_column(fps, real, train, generated, config), systems.label(fps)
        real_sets[name] = {"sequences": column.real.num_sequences, "seconds": column.real.duration_seconds}
        for sheet in sheets:
            with config.missing.skipping(f"{name}, {sheet.source.name}"):
                sheet.add(column, config)
        details += systems.detail_blocks(column.real, column.train, column.rows, config)
        del column
        for motion in (real, train):
            motion.forget_all_but(systems.LOW_FPS)
    copies: list[Block] = []
    with (
        task(config.on_progress, "copies of training motion"),
        config.missing.skipping("copies of training motion", (motions.NoRealMotionError, ValueError)),
    ):
        if train.name == real.name:
            raise motions.NoRealMotionError("the compared motion is the training motion")
        fields = {row: fields for row, fields in generated.items() if row.variant is Variant.AS_IS}
        slow = systems.generated_at(fields, real.at(systems.LOW_FPS), systems.LOW_FPS, Missing())
        # Of a system with a folder for each framerate, the slowest.
        folders = sorted(config.sample_folders, key=lambda each: name_and_fps(each.name)[1] or 0, reverse=True)
        slow |= {RowId(name_and_fps(each.name)[0]): each.at(systems.LOW_FPS) for each in folders}
        copies.append(copies_block(real.at(systems.LOW_FPS), train.at(systems.LOW_FPS), slow))
    protocol = config.clips
    return Content(
        caption=(
            f"clip-FID ({VERSION}), lower is better: mean over {counted(protocol.replications, 'replication')} of N = "
            f"{protocol.num_clips:,} random clips on each side, {config.real}, ± half the 95 % interval over takes "
            f"({protocol.resamplings} resamplings of the takes of both sides)."
        ),
        blocks=(
            *(
                block
                for number, sheet in enumerate(sheets)
                for block in sheet.blocks(tuple(real_sets), {} if number else notes, config)
            ),
            *details,
            *copies,
            printed_block(
                "Printed in the NeRM paper (HumanML3D)",
                reported_figures("nerm", "2"),
                lambda figure: systems.label(figure.setting),
                note=f"Of another feature extractor on other motions (docs/tables.md). Source: {SOURCES['nerm']}.",
            ),
        ),
        definition={"protocol": asdict(protocol), "real_sets": real_sets},
        notes=("Columns hold different sequences: numbers compare down a column, not along a row.",),
    )


TABLE = Table("nerm", "2", "clip-FID by framerate", VERSION, compute, shown=installed_models)


def _row_notes(training: Mapping[str, str], config: EvalConfig) -> dict[RowId, str]:
    own: dict[str, str] = dict(training)
    for folder in config.sample_folders:
        name = name_and_fps(folder.name)[0]
        own[name] = "; ".join(filter(None, (own.get(name, ""), folder.describe())))
    variants = {
        Variant.UPSAMPLED: UPSAMPLED_NOTE,
        Variant.AS_VECTORS: systems.ROW_NOTES[systems.VECTORS],
        **motions.VARIANT_NOTES,
    }
    of_variants = {RowId(system, variant): note for system in own for variant, note in variants.items()}
    return {**systems.ROW_NOTES, **{RowId(system): note for system, note in own.items()}, **of_variants}


def copies_block(held_out: SampleSet, training: SampleSet, others: Mapping[RowId, SampleSet]) -> Block:
    """The share of windows that are copies, and quantiles of the distance to training motion.

    Sets without a moving second have no row. Raises `ValueError` where the training motion is too short.
    """
    windows = motions.TrainingWindows.of(training)
    compared = {}
    # One thread is the fastest for matrices of this size.
    with threadpool_limits(1, "blas"):
        for row, samples in {HELD_OUT: held_out, **others}.items():
            some = np.sort(np.random.default_rng(0).permutation(samples.num_sequences)[:MAX_COPIES])
            compared[row] = windows.nearest(samples.select(some))
    own = compared[HELD_OUT].relative
    limit, rows = float(np.quantile(own, HELD_OUT_SHARE)) if len(own) else 0.0, []
    for row, nearest in compared.items():
        if not len(nearest.distance):
            continue
        cells = {COPIED: Cell(100.0 * float((nearest.relative < limit).mean()))}
        cells |= {name: Cell(1000.0 * float(np.quantile(nearest.distance, share))) for name, share in SHARES.items()}
        note = f"{counted(len(np.unique(nearest.motion)), 'motion')}, {counted(len(nearest.distance), 'window')}"
        rows.append(Row(str(row), "reference" if row == HELD_OUT else "ours", cells, note))
    return Block(COPIES, (COPIED, *SHARES), tuple(rows), note=COPIES_NOTE, provenance={"limit": limit})
