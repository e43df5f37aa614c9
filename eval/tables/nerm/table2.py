"""NeRM's Table 2: clip-FID at 20, 40, 60, 100 and 120 fps."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from itertools import chain
from typing import Any

from eval.clip_fid.clips import ClipError
from eval.clip_fid.features import Comparison, FeatureSource, feature_sources
from eval.clip_fid.kinematic import KinematicDescriptor
from eval.clip_fid.score import CLIP_FID, VERSION
from eval.metrics.number import Number
from eval.report.differences import differences_block, of_interest
from eval.report.results import Block, Cell, Result, Row, measure
from eval.sample_folder import SampleFolder
from eval.sample_folder.takes import takes_of_samples
from eval.sets.generated import sample_fields
from eval.sets.partial import PartialResult, collect
from eval.sets.planted import VARIANT_NOTES
from eval.sets.real import NoRealMotionError, RealMotion, real_motion, training_motion
from eval.sets.remarks import set_remarks
from eval.sets.row_ids import RowId, Variant
from eval.tables.models import generated_fields
from eval.tables.nerm.clip_fid_column import (
    LOW_FPS,
    MOTIONS,
    P1,
    P2,
    REFERENCES,
    SLERP,
    TAKES,
    TRAINING,
    VECTORS,
    Column,
    ColumnSize,
    ModelFields,
    framerate_label,
    make_column,
    samples_at,
    score_column,
)
from eval.tables.nerm.copies import copies_block
from eval.tables.nerm.detail_block import detail_block
from eval.tables.parts import SOURCES, printed_rows, reported_figures
from eval.tables.registry import Table, TableRequest
from motionkit.core.errors import MotionkitError
from motionkit.core.progress import task
from motionkit.generate.models import installed_models

COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
ROW_NOTES = {
    P1: "two draws from the same takes: what sampling alone leaves",
    P2: "takes of one half against takes of the other, few against few; ± is of a single split",
    TRAINING: (
        "random subsets of the training takes against the real ones, as many takes as the row with the fewest: what "
        "a generator that is real motion scores; ± is of a single subset"
    ),
    SLERP: "joint rotations on great arcs, the root on straight lines: the fair way to upsample",
    VECTORS: "humanml3d vectors interpolated with per-frame velocities unscaled: a handicap of the procedure",
}
GENERATED_NOTE = "asked for at the column's framerate, with the captions and durations of its real sequences"
UPSAMPLED_NOTE = (
    "the same motions asked for at 20 fps, then upsampled like the real ones; the kinks that this makes can stand "
    "in for detail that a smooth motion lacks (docs/metrics.md)"
)
SMALL_SECONDS = 3600.0
"""With less real motion at any framerate, the caption calls the table small-scale."""


@dataclass(frozen=True)
class _Scored:
    """One feature set's cells of one column by row, their differences and remarks."""

    cells: Mapping[RowId, Cell]
    differences: Mapping[tuple[RowId, RowId], Number]
    fingerprint: str
    warnings: tuple[str, ...]


# One feature set's scores by the columns' labels.
_Sheet = Mapping[str, _Scored]


def build_table2(request: TableRequest) -> Result:
    """Compute every possible row, and name those that are not.

    Raises `UsageError` or `StoreError` for a store that cannot be used, and `NoRealMotionError` if no column has
    real motion.
    """
    store = request.open_store()
    folders = request.sample_folders
    real = real_motion(store, request.real.split, request.real.where)
    train = training_motion(store, real)
    with task(request.on_progress, "real sets"):
        rates = _usable_rates(request.fps or COLUMNS, real)
    generated = generated_fields(request, real.at(min(rates.value)))
    fields = generated.value.rows
    notes = _row_notes(fields, folders, generated.value.training)
    sources = feature_sources(request.evaluators.names, request.evaluators.guo)
    sheets: list[dict[str, _Scored]] = [{} for _ in sources.value]
    absent: list[list[str]] = [[] for _ in sources.value]
    sizes: list[ColumnSize] = []
    remarks: list[str] = []
    slow: list[str] = []
    details: list[Block | None] = []
    for fps in rates.value:
        # One column's motions at a time: all framerates together need three times the memory.
        samples = samples_at(folders, real, fps, request.on_progress)
        made = make_column(fps, real, train, fields, samples.value)
        column = made.value.low_passed(request.clip_fid.low_pass_hz)
        slow += (*made.missing, *samples.missing)
        sizes.append(column.size)
        remarks += set_remarks(column.real, column.others)
        for source, sheet, lines in zip(sources.value, sheets, absent, strict=True):
            scored = _scored(source, column, request)
            sheet.update(scored.value)
            lines += scored.missing
        with task(request.on_progress, f"detail, {column.label}"):
            try:
                details.append(detail_block(column, notes, request.seed))
            except ClipError as error:
                slow.append(f"detail, {column.label}: {error}")
        del samples, made, column
        for motion in (real, train):
            motion.forget_all_but(LOW_FPS)
    by_source = zip(sources.value, sheets, strict=True)
    blocks = [block for source, sheet in by_source for block in _blocks(source, sheet, sizes, notes, request)]
    with task(request.on_progress, "copies of training motion"):
        copies = _copies(real, train, fields, folders, notes)
    missing = (*rates.missing, *generated.missing, *slow, *sources.missing, *chain(*absent), *copies.missing)
    return Result(
        task="nerm-table2",
        version=VERSION,
        title="Table 2: clip-FID by framerate",
        caption=_caption(sizes, request),
        blocks=(*(block for block in (*blocks, *details, *copies.value) if block and block.rows), _paper_block()),
        definition=_definition(sizes, request),
        notes=(*_notes(sizes, request), *_sample_notes(real, folders), *dict.fromkeys(remarks)),
        missing=tuple(dict.fromkeys(missing)),
        provenance=request.provenance(
            store,
            run=request.evaluated.run.name if request.evaluated.run and fields else None,
            samples={folder.name: folder.fingerprint for folder in folders},
        ),
    )


TABLE = Table("nerm", "2", "clip-FID by framerate", build_table2, shown=installed_models)


def _usable_rates(rates: tuple[Fraction, ...], real: RealMotion) -> PartialResult[list[Fraction]]:
    usable = collect(rates, real.indices_at, "{} fps".format, (NoRealMotionError,))
    if not usable.value:
        raise NoRealMotionError(usable.missing[-1] if usable.missing else "no framerate was asked for")
    return PartialResult(list(usable.value), usable.missing)


def _row_notes(
    models: Iterable[RowId], folders: Sequence[SampleFolder], trained: Mapping[str, str]
) -> dict[RowId, str]:
    notes = dict(ROW_NOTES)
    for system in dict.fromkeys(row.system for row in models):
        notes |= {
            RowId(system): "; ".join(filter(None, (GENERATED_NOTE, trained.get(system)))),
            RowId(system, Variant.UPSAMPLED): UPSAMPLED_NOTE,
            RowId(system, Variant.AS_VECTORS): ROW_NOTES[VECTORS],
            **{RowId(system, variant): note for variant, note in VARIANT_NOTES.items()},
        }
    for folder in folders:
        planted = RowId(folder.name, Variant.PLANTED)
        notes |= {RowId(folder.name): folder.describe(), planted: VARIANT_NOTES[Variant.PLANTED]}
    return notes


def _copies(
    real: RealMotion,
    train: RealMotion,
    fields: ModelFields,
    folders: Sequence[SampleFolder],
    notes: Mapping[RowId, str],
) -> PartialResult[tuple[Block, ...]]:
    """The block on copies of training motion; none if there is no training split or it is too short."""
    try:
        if train.name == real.name:
            raise NoRealMotionError("the compared motion is the training motion")
        held_out, training = real.at(LOW_FPS), train.at(LOW_FPS)
        generated = {
            row: sample_fields(own, held_out.sequence_ids, LOW_FPS, str(row))
            for row, own in fields.items()
            if row.variant is Variant.AS_IS
        }
        others = {row: samples for row, samples in generated.items() if samples is not None}
        others |= {RowId(folder.name): folder.at(LOW_FPS) for folder in folders}
        return PartialResult((copies_block(held_out, training, others, notes),))
    except (NoRealMotionError, ValueError) as error:
        return PartialResult((), (f"copies of training motion: {error}",))


def _scored(source: FeatureSource, column: Column, request: TableRequest) -> PartialResult[dict[str, _Scored]]:
    """A column's rows on one feature set, under the column's label."""
    label = column.label
    try:
        comparison = column.comparison(source, request.clip_fid.protocol)
        costs = comparison.protocol.costs(len(column.rows))
        with task(request.on_progress, f"{source.name}, {label}", sum(costs)) as work:
            left = iter(costs)
            found = score_column(comparison, column.rows, lambda: work.advance(next(left)), column.subset_sizes)
    except MotionkitError as error:
        return PartialResult({}, (f"{label}, {source.name}: {error}",))
    features = comparison.features
    if isinstance(features, KinematicDescriptor):
        features.save(request.results / "features" / f"kinematic-{features.fingerprint}.npz")
    warnings = tuple(_too_few(column, comparison))
    scores = found.value
    return PartialResult(
        {label: _Scored(scores.cells, scores.differences, features.fingerprint, warnings)}, found.missing
    )


def _blocks(
    source: FeatureSource,
    sheet: _Sheet,
    columns: Sequence[ColumnSize],
    notes: Mapping[RowId, str],
    request: TableRequest,
) -> list[Block]:
    """The scores, and which rows differ."""
    rows = dict.fromkeys((*REFERENCES, *(row for scored in sheet.values() for row in scored.cells)))
    cells = {row: {label: scored.cells[row] for label, scored in sheet.items() if row in scored.cells} for row in rows}
    warnings = dict.fromkeys(warning for scored in sheet.values() for warning in scored.warnings)
    labels, metrics = tuple(column.label for column in columns), (measure(CLIP_FID),)
    pairs = dict.fromkeys(pair for scored in sheet.values() for pair in scored.differences)
    differences = {
        pair: {label: scored.differences[pair] for label, scored in sheet.items() if pair in scored.differences}
        for pair in pairs
    }
    scores = Block(
        source.title,
        labels,
        tuple(
            Row(
                str(row),
                "reference" if row in REFERENCES else "ours",
                found,
                "; ".join(filter(None, (notes.get(row, ""), _counted(found)))),
            )
            for row, found in cells.items()
            if found
        ),
        note=" ".join((source.note, *warnings)).strip(),
        provenance={
            "fingerprints": {label: scored.fingerprint for label, scored in sheet.items()},
            "replications": source.protocol(request.clip_fid.protocol).replications,
        },
        metrics=metrics,
    )
    tests = differences_block(scores, of_interest(scores, differences))
    return [scores] if tests is None or not scores.rows else [scores, tests]


def _counted(cells: Mapping[str, Cell]) -> str:
    """Numbers of motions and takes of a row: "52 motions of 30 takes at 100 and 120 fps"."""
    columns: dict[str, list[str]] = {}
    for label, cell in cells.items():
        motions, takes = (int(cell.details[name]) for name in (MOTIONS, TAKES))
        columns.setdefault(f"{motions:,} motions of {takes:,} takes", []).append(label.removesuffix(" fps"))
    listed = {count: " and ".join(filter(None, (", ".join(rates[:-1]), rates[-1]))) for count, rates in columns.items()}
    return ", ".join(f"{count} at {rates} fps" for count, rates in listed.items())


def _too_few(column: Column, comparison: Comparison) -> list[str]:
    """Remarks on columns with no more samples than features, whose covariances are singular."""
    protocol = comparison.protocol
    size = comparison.num_features
    advice = "quote KID, precision and recall (in the JSON's details), and give more"
    found = []
    if protocol.num_clips <= size:
        found.append(
            f"With {protocol.num_clips} clips for {size} features every covariance is singular: clip-FID is "
            f"still the distance of the two fitted Gaussians, and says little about the motions; {advice} clips."
        )
    counts = {str(row): column.rows[row].num_sequences for row in (*column.models, *column.samples)}
    counts = {"the real set": column.real.num_sequences, **counts}
    few = {name: count for name, count in counts.items() if count <= size}
    if few:
        named = ", ".join(f"{name} ({count})" for name, count in few.items())
        # The first is the same for all columns, and added once.
        found += [
            f"Where clips are parts of a few motions, clip-FID says how those differ; {advice} motions.",
            f"At {column.label} these have no more motions than there are features ({size}): {named}.",
        ]
    return found


def _paper_block() -> Block:
    figures = reported_figures("nerm", "2")
    return Block(
        title="Printed in the NeRM paper (HumanML3D)",
        columns=tuple(dict.fromkeys(framerate_label(figure.setting) for figure in figures)),
        rows=printed_rows(figures, lambda figure: framerate_label(figure.setting)),
        note=(
            "These numbers cannot be compared with ours: they are from another feature extractor on another data set, "
            "the paper does not say how many clips of which sizes it draws, how the extractor is used away from 20 fps "
            "or what the real set at a target framerate is, and at 20 fps it prints its Table 1's FID of whole motions "
            f"for every method. Source: {SOURCES['nerm']}."
        ),
    )


def _caption(columns: Sequence[ColumnSize], request: TableRequest) -> str:
    protocol = request.clip_fid.protocol
    seconds = [column.duration_seconds for column in columns]
    caption = (
        f"clip-FID ({VERSION}), lower is better: mean over {protocol.replications} replications of N = "
        f"{protocol.num_clips:,} random clips on each side, {request.real.named}, ± half the 95 % interval over "
        f"takes ({protocol.resamplings} resamplings of the takes of both sides)."
    )
    if request.clip_fid.low_pass_hz is not None:
        caption += f" Every set, the real one too, was low-passed at {request.clip_fid.low_pass_hz:g} Hz."
    if min(seconds) < SMALL_SECONDS:
        caption += (
            f" A small-scale run: the real sets hold {min(seconds) / 60:.1f} to {max(seconds) / 60:.1f} minutes of "
            "motion, so rows say how systems rank on this store and no more."
        )
    return caption


def _definition(columns: Sequence[ColumnSize], request: TableRequest) -> dict[str, Any]:
    protocol = asdict(request.clip_fid.protocol)
    kind = type(request.clip_fid.protocol.sizes).__name__
    return {
        "version": VERSION,
        "protocol": protocol | {"sizes": {"kind": kind, **protocol["sizes"]}},
        "real_sets": {
            column.label: {
                "sequences": column.num_sequences,
                "seconds": round(column.duration_seconds, 3),
            }
            for column in columns
        },
        "generated_motions": {column.label: dict(column.num_generated) for column in columns if column.num_generated},
        "sequences": "native framerate at least the column's, brought to it by anti-aliased resampling",
        "clips": "both sides share sizes and centre quantiles; each draws sequences in proportion to duration",
        "split": request.real.split,
        "where": request.real.where,
        "low_pass_hz": request.clip_fid.low_pass_hz,
    }


def _notes(columns: Sequence[ColumnSize], request: TableRequest) -> tuple[str, ...]:
    sets = "; ".join(
        f"{column.label}: {column.num_sequences} sequences, {column.duration_seconds / 60:.1f} min"
        for column in columns
    )
    return (
        f"Real sets: {sets}.",
        "Columns hold different sequences, so numbers compare down a column, not along a row.",
        "An interval says how far a score would move with as many other takes of the same kind"
        + (", and with other generations. " if request.evaluated.draws > 1 else ". ")
        + "Few takes push every score up, which no interval holds: compare with the row of training takes.",
        "clip-FID here has nothing to do with the FID of images on CLIP features.",
    )


def _sample_notes(real: RealMotion, folders: Sequence[SampleFolder]) -> tuple[str, ...]:
    notes = []
    for folder in folders:
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
    return tuple(notes)
