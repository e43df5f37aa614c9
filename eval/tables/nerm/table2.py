"""NeRM's Table 2: clip-FID at 20, 40, 60, 100 and 120 fps, the detail profile, and copies of training motion."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from threadpoolctl import threadpool_limits

from eval.clip_fid.score import CLIP_FID, VERSION, Comparison, FeatureSource, feature_sources
from eval.config import EvalConfig
from eval.metrics.number import Number
from eval.report.results import Block, Cell, Row, differences_block, measure, of_interest
from eval.sample_folder.folder import takes_of_samples
from eval.sets.copies import HELD_OUT_SHARE, STILL_METRES, TrainingWindows, held_out_limit
from eval.sets.motions import VARIANT_NOTES, NoRealMotionError, RealMotion, real_motion, sample_fields, training_motion
from eval.sets.sets import REAL, RowId, SampleSet, Variant, set_remarks
from eval.tables.columns import (
    COLUMNS,
    LOW_FPS,
    MOTIONS,
    REFERENCES,
    ROW_NOTES,
    TAKES,
    VECTORS,
    Column,
    ModelFields,
    detail_blocks,
    label,
    make_column,
    score_column,
)
from eval.tables.models import Generated, generated_fields
from eval.tables.table import SOURCES, Content, Table, printed_block, reported_figures
from motionkit.core.progress import task
from motionkit.generate.models import installed_models
from motionkit.store.reader import Store

GENERATED_NOTE = "asked for at the column's framerate, with the captions and durations of its real sequences"
UPSAMPLED_NOTE = (
    "the same motions asked for at 20 fps, then upsampled like the real ones; the kinks that this makes can stand "
    "in for detail that a smooth motion lacks (docs/metrics.md)"
)
SMALL_SECONDS = 3600.0
"""With less real motion at any framerate, the caption calls the table small-scale."""
COPIES = "Copies of training motion"
HELD_OUT = RowId(REAL.system, Variant.HELD_OUT)
COPIED = "copied (%)"
SHARES = {"nearest (mm)": 0.0, "5 % (mm)": 0.05, "25 % (mm)": 0.25, "50 % (mm)": 0.5, "95 % (mm)": 0.95}
MAX_COPIES = 60
COPIES_NOTE = (
    "The nearest training motion to every second of a motion, whatever its body, tempo (0.8 to 1.25) and side. Copied "
    f"are windows that are nearer, for how much they move, than {HELD_OUT_SHARE:.0%} of held-out real motion's are. "
    f"Windows that move less than {1000 * STILL_METRES:g} mm say nothing and are left out. The last columns hold the "
    "distance within which that share of the windows has training motion. A copy that a model makes is as far from its "
    "original as the model reconstructs (Table 4), so where that is more than about 10 mm read these beside held-out "
    f"motion's. Of rows with more than {MAX_COPIES} motions, {MAX_COPIES} random ones are looked at."
)


@dataclass(eq=False)
class _Sheet:
    """One feature set's cells and differences by row and column, its fingerprints by column, and remarks."""

    source: FeatureSource
    cells: dict[RowId, dict[str, Cell]] = field(default_factory=lambda: {row: {} for row in REFERENCES})
    differences: dict[tuple[RowId, RowId], dict[str, Number]] = field(default_factory=dict)
    fingerprints: dict[str, str] = field(default_factory=dict)
    warnings: dict[str, None] = field(default_factory=dict)

    def add(self, column: Column, config: EvalConfig) -> None:
        """Score a column's rows."""
        comparison = _comparison(self.source, column, config)
        # Once with all rows, once for the halves.
        steps = 2 * comparison.protocol.replications
        with task(config.on_progress, f"{self.source.name}, {column.label}", steps) as work:
            cells, differences = score_column(
                comparison, column.rows, config.missing, work.advance, column.subset_sizes
            )
        features = comparison.features
        for row, cell in cells.items():
            self.cells.setdefault(row, {})[column.label] = cell
        for pair, difference in differences.items():
            self.differences.setdefault(pair, {})[column.label] = difference
        self.fingerprints[column.label] = features.fingerprint
        self.warnings |= dict.fromkeys(_too_few(column, comparison))

    def blocks(self, labels: tuple[str, ...], notes: Mapping[RowId, str], config: EvalConfig) -> list[Block]:
        """The scores, and which rows differ."""
        rows = tuple(
            Row(
                str(row),
                "reference" if row in REFERENCES else "ours",
                cells,
                "; ".join(filter(None, (notes.get(row, ""), _counted(cells)))),
            )
            for row, cells in self.cells.items()
            if cells
        )
        provenance = {
            "fingerprints": self.fingerprints,
            "replications": self.source.protocol(config.clips).replications,
        }
        note = " ".join((self.source.note, *self.warnings)).strip()
        scores = Block(self.source.title, labels, rows, note=note, provenance=provenance, metrics=(measure(CLIP_FID),))
        tests = differences_block(scores, of_interest(scores, self.differences))
        return [scores] if tests is None or not rows else [scores, tests]


def compute(config: EvalConfig, store: Store) -> Content:
    """Compute every possible row, and name those that are not.

    Raises `UsageError` or `StoreError` for a store that cannot be used, and `NoRealMotionError` if no column has
    real motion.
    """
    real = real_motion(store, config.split, config.where)
    train = training_motion(store, real)
    with task(config.on_progress, "real sets"):
        rates = []
        for fps in config.fps or COLUMNS:
            with config.missing.skipping(f"{fps} fps", (NoRealMotionError,)):
                real.indices_at(fps)
                rates.append(fps)
    if not rates:
        raise NoRealMotionError(config.missing.lines[-1])
    generated = generated_fields(config, real.at(min(rates)))
    notes = _row_notes(generated, config)
    sheets = [_Sheet(source) for source in feature_sources(config.evaluators, config.guo, config.missing)]
    sizes: dict[str, tuple[int, float]] = {}
    num_generated: dict[str, dict[str, int]] = {}
    remarks: dict[str, None] = {}
    details: list[Block] = []
    for fps in rates:
        # One column's motions at a time: all framerates together need three times the memory.
        column = make_column(fps, real, train, generated.rows, config).low_passed(config.low_pass_hz)
        sizes[column.label] = column.real.num_sequences, column.real.duration_seconds
        num_generated[column.label] = {
            str(row): column.rows[row].num_sequences for row in column.systems if row in generated.rows
        }
        remarks |= dict.fromkeys(set_remarks(column.real, column.others))
        for sheet in sheets:
            with config.missing.skipping(f"{column.label}, {sheet.source.name}"):
                sheet.add(column, config)
        details += detail_blocks(column.real, column.train, column.rows, notes, config)
        del column
        for motion in (real, train):
            motion.forget_all_but(LOW_FPS)
    labels = tuple(sizes)
    with task(config.on_progress, "copies of training motion"):
        copies = _copies(real, train, generated.rows, notes, config)
    return Content(
        caption=_caption([seconds for _, seconds in sizes.values()], config),
        blocks=(
            *(block for sheet in sheets for block in sheet.blocks(labels, notes, config)),
            *details,
            *copies,
            _paper_block(),
        ),
        definition={
            "protocol": asdict(config.clips),
            "real_sets": {column: {"sequences": number, "seconds": each} for column, (number, each) in sizes.items()},
            "generated_motions": num_generated,
        },
        notes=(*_notes(sizes, config), *_sample_notes(real, config), *remarks),
    )


TABLE = Table("nerm", "2", "clip-FID by framerate", VERSION, compute, shown=installed_models)


def _comparison(source: FeatureSource, column: Column, config: EvalConfig) -> Comparison:
    if column.train is None:
        raise NoRealMotionError("the training split has no motion at this framerate")
    return source.comparison(column.real, column.train, config.clips)


def _row_notes(generated: Generated, config: EvalConfig) -> dict[RowId, str]:
    notes = dict(ROW_NOTES)
    for system in dict.fromkeys(row.system for row in generated.rows):
        notes |= {
            RowId(system): "; ".join(filter(None, (GENERATED_NOTE, generated.training.get(system)))),
            RowId(system, Variant.UPSAMPLED): UPSAMPLED_NOTE,
            RowId(system, Variant.AS_VECTORS): ROW_NOTES[VECTORS],
            **{RowId(system, variant): note for variant, note in VARIANT_NOTES.items()},
        }
    for folder in config.sample_folders:
        planted = RowId(folder.name, Variant.PLANTED)
        notes |= {RowId(folder.name): folder.describe(), planted: VARIANT_NOTES[Variant.PLANTED]}
    return notes


def _copies(
    real: RealMotion, train: RealMotion, fields: ModelFields, notes: Mapping[RowId, str], config: EvalConfig
) -> list[Block]:
    """The block on copies of training motion; none if there is no training split or it is too short."""
    blocks = []
    with config.missing.skipping("copies of training motion", (NoRealMotionError, ValueError)):
        if train.name == real.name:
            raise NoRealMotionError("the compared motion is the training motion")
        held_out, training = real.at(LOW_FPS), train.at(LOW_FPS)
        generated = {
            row: sample_fields(own, held_out.sequence_ids, LOW_FPS, str(row))
            for row, own in fields.items()
            if row.variant is Variant.AS_IS
        }
        others = {row: samples for row, samples in generated.items() if samples is not None}
        others |= {RowId(folder.name): folder.at(LOW_FPS) for folder in config.sample_folders}
        blocks.append(copies_block(held_out, training, others, notes))
    return blocks


def copies_block(
    held_out: SampleSet, training: SampleSet, others: Mapping[RowId, SampleSet], notes: Mapping[RowId, str]
) -> Block:
    """The share of windows that are copies, and quantiles of the distance to training motion.

    Sets without a moving second have no row. Raises `ValueError` where the training motion is too short.
    """
    windows = TrainingWindows.of(training)
    found = {}
    # One thread is the fastest for matrices of this size.
    with threadpool_limits(1, "blas"):
        for row, samples in {HELD_OUT: held_out, **others}.items():
            some = np.sort(np.random.default_rng(0).permutation(samples.num_sequences)[:MAX_COPIES])
            found[row] = windows.nearest(samples.select(some))
    limit, rows = held_out_limit(found[HELD_OUT]), []
    for row, nearest in found.items():
        if not len(nearest.distance):
            continue
        cells = {COPIED: Cell(100.0 * float(nearest.is_copied(limit).mean()))}
        cells |= {label: Cell(1000.0 * float(np.quantile(nearest.distance, share))) for label, share in SHARES.items()}
        count = f"{len(np.unique(nearest.motion))} motions, {len(nearest.distance)} windows"
        note = "; ".join(filter(None, (count, notes.get(row, ""))))
        rows.append(Row(str(row), "reference" if row == HELD_OUT else "ours", cells, note))
    return Block(COPIES, (COPIED, *SHARES), tuple(rows), note=COPIES_NOTE, provenance={"limit": limit})


def _counted(cells: Mapping[str, Cell]) -> str:
    """Numbers of motions and takes of a row: "52 motions of 30 takes at 100 and 120 fps"."""
    columns: dict[str, list[str]] = {}
    for column, cell in cells.items():
        motions, takes = (int(cell.details[name]) for name in (MOTIONS, TAKES))
        columns.setdefault(f"{motions:,} motions of {takes:,} takes", []).append(column.removesuffix(" fps"))
    listed = {count: " and ".join(filter(None, (", ".join(rates[:-1]), rates[-1]))) for count, rates in columns.items()}
    return ", ".join(f"{count} at {rates} fps" for count, rates in listed.items())


def _too_few(column: Column, comparison: Comparison) -> list[str]:
    """Remarks on columns with no more samples than features, whose covariances are singular."""
    num_clips, size = comparison.protocol.num_clips, comparison.num_features
    advice = "quote KID, precision and recall (in the JSON's details), and give more"
    found = []
    if num_clips <= size:
        found.append(
            f"With {num_clips} clips for {size} features every covariance is singular: clip-FID is "
            f"still the distance of the two fitted Gaussians, and says little about the motions; {advice} clips."
        )
    counts = {"the real set": column.real.num_sequences}
    counts |= {str(row): column.rows[row].num_sequences for row in column.systems}
    few = ", ".join(f"{name} ({count})" for name, count in counts.items() if count <= size)
    if few:
        # The first is the same for all columns, and added once.
        found += [
            f"Where clips are parts of a few motions, clip-FID says how those differ; {advice} motions.",
            f"At {column.label} these have no more motions than there are features ({size}): {few}.",
        ]
    return found


def _paper_block() -> Block:
    return printed_block(
        "Printed in the NeRM paper (HumanML3D)",
        reported_figures("nerm", "2"),
        lambda figure: label(figure.setting),
        note=(
            "These numbers cannot be compared with ours: they are from another feature extractor on another data set, "
            "the paper does not say how many clips of which sizes it draws, how the extractor is used away from 20 fps "
            "or what the real set at a target framerate is, and at 20 fps it prints its Table 1's FID of whole motions "
            f"for every method. Source: {SOURCES['nerm']}."
        ),
    )


def _caption(seconds: Sequence[float], config: EvalConfig) -> str:
    protocol = config.clips
    caption = (
        f"clip-FID ({VERSION}), lower is better: mean over {protocol.replications} replications of N = "
        f"{protocol.num_clips:,} random clips on each side, {config.real}, ± half the 95 % interval over "
        f"takes ({protocol.resamplings} resamplings of the takes of both sides)."
    )
    if config.low_pass_hz is not None:
        caption += f" Every set, the real one too, was low-passed at {config.low_pass_hz:g} Hz."
    if min(seconds) < SMALL_SECONDS:
        caption += (
            f" A small-scale run: the real sets hold {min(seconds) / 60:.1f} to {max(seconds) / 60:.1f} minutes of "
            "motion, so rows say how systems rank on this store and no more."
        )
    return caption


def _notes(sizes: Mapping[str, tuple[int, float]], config: EvalConfig) -> tuple[str, ...]:
    sets = "; ".join(
        f"{column}: {number} sequences, {seconds / 60:.1f} min" for column, (number, seconds) in sizes.items()
    )
    return (
        f"Real sets: {sets}.",
        "Columns hold different sequences, so numbers compare down a column, not along a row.",
        "An interval says how far a score would move with as many other takes of the same kind"
        + (", and with other generations. " if config.draws > 1 else ". ")
        + "Few takes push every score up, which no interval holds: compare with the row of training takes.",
        "clip-FID here has nothing to do with the FID of images on CLIP features.",
    )


def _sample_notes(real: RealMotion, config: EvalConfig) -> list[str]:
    notes = []
    for folder in config.sample_folders:
        found = takes_of_samples(folder, real)
        if not any(found.takes):
            notes.append(
                f"{folder.name}: neither names nor captions say for which real takes its motions were made, so all of "
                "them are in every column, though a column's real set holds the takes that are fast enough."
            )
        elif found.num_without:
            notes.append(
                f"{folder.name}: {found.num_without:,} of {folder.num_motions:,} motions are for none of the compared "
                "takes, by name or caption: left out."
            )
    return notes
