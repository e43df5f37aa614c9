"""NeRM's Table 2: clip-FID at 20, 40, 60, 100 and 120 fps."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from eval.clip_fid.feature_set import FeatureSet
from eval.clip_fid.features import FeatureSource, feature_sources
from eval.clip_fid.kinematic import KinematicDescriptor
from eval.clip_fid.score import (
    VERSION,
    ClipError,
    ClipFid,
    Protocol,
    check_lengths,
    score_disjoint_halves,
    score_rows,
)
from eval.report.results import Block, Cell, Result, Row, environment
from eval.sample_folder import SampleFolder
from eval.sets.generated import Window, generate_fields, sample_fields, windows_of
from eval.sets.memorisation import SAMPLED_FPS
from eval.sets.real import NoRealMotionError, RealMotion, real_motion
from eval.sets.remarks import set_remarks
from eval.tables.models import check_names, trained_models
from eval.tables.nerm.clip_fid_column import (
    GENERATED_LOW,
    LOW_FPS,
    P1,
    P2,
    REFERENCES,
    SLERP,
    VECTORS,
    Column,
    ColumnSize,
    ModelFields,
    framerate_label,
    make_column,
    nearest_training_block,
    samples_at,
)
from eval.tables.parts import SOURCES, reported_figures
from eval.tables.registry import Table, TableRequest
from motionkit.core.errors import MotionkitError
from motionkit.core.files import require_no_link
from motionkit.core.progress import OnProgress, task
from motionkit.fields.motion_field import MotionField

if TYPE_CHECKING:
    from motionkit.store.reader import Store

COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
ROW_NOTES = {
    P1: "two draws from the same takes: what sampling alone leaves",
    P2: "takes of one half against takes of the other: what a faithful model of other takes could reach",
    SLERP: "joint rotations on great arcs, the root on straight lines: the fair way to upsample",
    VECTORS: "humanml3d vectors interpolated with per-frame velocities unscaled: a handicap of the procedure",
}
GENERATED_NOTE = "asked for at the column's framerate, with the captions and durations of its real sequences"
GENERATED_LOW_NOTE = (
    "the same motions asked for at 20 fps, then upsampled like the real ones; the kinks that this makes can stand "
    "in for detail that a smooth motion lacks (docs/metrics.md)"
)
DETAIL_NAMES = {
    "fid_infinity": "FID_∞",
    "kid": "KID",
    "precision": "precision",
    "recall": "recall",
    "density": "density",
    "coverage": "coverage",
}
SMALL_SECONDS = 3600.0
"""Less real motion than this at any framerate makes a table a small-scale one, and its caption says so."""


@dataclass(frozen=True)
class _Sheet:
    """One feature set's numbers, filled a column at a time: cells by row and column, and what is to be said of them."""

    source: FeatureSource
    protocol: Protocol
    cells: dict[str, dict[str, Cell]] = field(default_factory=dict)
    fingerprints: dict[str, str] = field(default_factory=dict)
    warnings: dict[str, None] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)


def build_table2(request: TableRequest) -> Result:
    """Compute every row that can be computed; what cannot is named in `missing`.

    Raises `UsageError` or `StoreError` for a store that cannot be used, and `NoRealMotionError` where no column has
    real motion.
    """
    store = request.open_store()
    folders = request.sample_folders
    real = real_motion(store, request.split, request.where)
    train = _training_motion(store, real)
    missing: list[str] = []
    with task(request.on_progress, "real sets"):
        rates = _usable_rates(request.fps or COLUMNS, real, missing)
    with task(request.on_progress, "generating", 1):
        fields = _generated_fields(request, real, rates, missing)
    check_names(request.samples, _model_notes(fields))
    notes = ROW_NOTES | _model_notes(fields) | {folder.name: folder.describe() for folder in folders}
    without: list[str] = []
    sources = feature_sources(request.run, request.features, without, request.guo)
    sheets = [_Sheet(source, source.protocol(request.protocol)) for source in sources]
    sizes: list[ColumnSize] = []
    remarks: list[str] = []
    for fps in rates:
        # One column's motions at a time: those of all framerates together are three times as many.
        samples = samples_at(folders, fps, request.on_progress)
        column = make_column(fps, real, train, fields, samples, missing).low_passed(request.low_pass_hz)
        sizes.append(column.size)
        remarks += set_remarks(column.real, column.others)
        for sheet in sheets:
            _fill(sheet, column, request)
        del samples, column
        for motion in (real, train):
            motion.forget_all_but(LOW_FPS)
    missing += [*without, *(line for sheet in sheets for line in sheet.missing)]
    blocks = tuple(_block(sheet, sizes, notes) for sheet in sheets)
    with task(request.on_progress, "nearest training motion"):
        nearest = _nearest_training(real, train, fields, folders, notes, missing)
    return Result(
        task="nerm-table2",
        version=VERSION,
        title="Table 2: clip-FID by framerate",
        caption=_caption(sizes, request),
        blocks=(*(block for block in (*blocks, *nearest) if block.rows), _paper_block()),
        definition=_definition(sizes, request),
        notes=(*_notes(sizes), *_sample_notes(sizes, folders), *dict.fromkeys(remarks)),
        missing=tuple(dict.fromkeys(missing)),
        provenance={
            "store": {"path": request.store.name, "fingerprint": store.fingerprint},
            "run": request.run.name if request.run and fields else None,
            "samples": {folder.name: folder.fingerprint for folder in folders},
            "seed": request.seed,
            "environment": environment(),
        },
    )


TABLE = Table("nerm", "2", "clip-FID by framerate", build_table2)


def _training_motion(store: "Store", real: RealMotion) -> RealMotion:
    """What the descriptor is fitted on: the training split, or the compared sequences where there is none."""
    has_training = bool((store.columns("split")["split"] == "train").any())
    return real_motion(store, "train") if has_training else real


def _usable_rates(rates: tuple[Fraction, ...], real: RealMotion, missing: list[str]) -> list[Fraction]:
    usable = []
    for fps in rates:
        try:
            real.indices_at(fps)
        except NoRealMotionError as error:
            missing.append(f"{fps} fps: {error}")
        else:
            usable.append(fps)
    if not usable:
        raise NoRealMotionError(missing[-1] if missing else "no framerate was asked for")
    return usable


def _generated_fields(
    request: TableRequest, real: RealMotion, rates: list[Fraction], missing: list[str]
) -> dict[str, dict[Window, MotionField]]:
    """Motions that each of the run's models generates for the real sequences of the lowest framerate."""
    found: dict[str, dict[Window, MotionField]] = {}
    for name, trained in trained_models(request.run, missing).items():
        model = trained.loaded
        try:
            windows = windows_of(real.at(min(rates)), model.max_duration_seconds)
            found[name] = generate_fields(model, windows, request.seed, request.max_motions)
        except MotionkitError as error:
            missing.append(f"{name}: {error}")
    return found


def _model_notes(models: Iterable[str]) -> dict[str, str]:
    notes: dict[str, str] = {}
    for name in models:
        notes |= {name: GENERATED_NOTE, GENERATED_LOW.format(name): GENERATED_LOW_NOTE}
    return notes


def _nearest_training(
    real: RealMotion,
    train: RealMotion,
    fields: ModelFields,
    folders: Sequence[SampleFolder],
    notes: Mapping[str, str],
    missing: list[str],
) -> tuple[Block, ...]:
    """The block that tells copies; none where there is no training split or it is too short."""
    try:
        if train.name == real.name:
            raise NoRealMotionError("the compared motion is the training motion")
        held_out, training = real.at(SAMPLED_FPS), train.at(SAMPLED_FPS)
        generated = {name: sample_fields(own, held_out.sequence_ids, SAMPLED_FPS, name) for name, own in fields.items()}
        others = {name: samples for name, samples in generated.items() if samples is not None}
        others |= {folder.name: folder.at(SAMPLED_FPS) for folder in folders}
        return (nearest_training_block(held_out, training, others, notes),)
    except (NoRealMotionError, ValueError) as error:
        missing.append(f"distance to the nearest training motion: {error}")
        return ()


def _fill(sheet: _Sheet, column: Column, request: TableRequest) -> None:
    """Score a column's rows; numbers that cannot be had are named in the sheet's `missing`."""
    label, source = column.label, sheet.source
    if column.train is None:
        sheet.missing.append(f"{label}, {source.name}: the training split has no motion at this framerate")
        return
    try:
        check_lengths(column.real, sheet.protocol)
        features = source.fit(column.train)
        scores = _scores(column, features, source, sheet.protocol, request.on_progress, sheet.missing)
    except MotionkitError as error:
        sheet.missing.append(f"{label}, {source.name}: {error}")
        return
    sheet.fingerprints[label] = features.fingerprint
    if isinstance(features, KinematicDescriptor):
        folder = request.results / "features"
        require_no_link(folder, "delete the link, or name another folder with --results")
        features.save(folder / f"kinematic-{features.fingerprint}.npz")
    said = [*_too_few(column, features, sheet.protocol), source.remark_at(column.fps)]
    sheet.warnings.update(dict.fromkeys(filter(None, said)))
    for name, score in scores.items():
        sheet.cells.setdefault(name, {})[label] = clip_fid_cell(score)


def _block(sheet: _Sheet, columns: Sequence[ColumnSize], notes: Mapping[str, str]) -> Block:
    cells = sheet.cells
    order = [*REFERENCES, *(name for name in cells if name not in REFERENCES)]
    rows = tuple(
        Row(name, "reference" if name in REFERENCES else "ours", cells[name], notes.get(name, ""))
        for name in order
        if name in cells
    )
    return Block(
        sheet.source.title,
        tuple(column.label for column in columns),
        rows,
        note=" ".join((sheet.source.note, *sheet.warnings)).strip(),
        provenance={"fingerprints": sheet.fingerprints, "replications": sheet.protocol.replications},
    )


def _too_few(column: Column, features: FeatureSet, protocol: Protocol) -> list[str]:
    """What must be said where there are no more samples than features: covariances are then singular."""
    smallest = int(protocol.sizes.sizes(column.fps).min())
    poses = column.real.sequences.clips(np.zeros(1, dtype=np.int64), smallest)
    num_features = features.describe(poses, column.fps).shape[1]
    advice = "quote KID, precision and recall (in the JSON's details), and give more"
    found = []
    if protocol.num_clips <= num_features:
        found.append(
            f"With {protocol.num_clips} clips for {num_features} features every covariance is singular: clip-FID is "
            f"still the distance of the two fitted Gaussians, and says little about the motions; {advice} clips."
        )
    counts = {name: column.rows[name].num_sequences for name in column.samples}
    few = {name: count for name, count in counts.items() if count <= num_features}
    found += [
        f"{name!r} has {count} motions, no more than there are features ({num_features}): its clips are parts of the "
        f"same few motions, and its clip-FID says how those differ; {advice} motions."
        for name, count in few.items()
    ]
    return found


def _scores(
    column: Column,
    features: FeatureSet,
    source: FeatureSource,
    protocol: Protocol,
    on_progress: OnProgress,
    missing: list[str],
) -> dict[str, ClipFid]:
    label = column.label
    rows = {}
    for name, samples in column.rows.items():
        try:
            check_lengths(samples, protocol)
            rows[name] = samples
        except ClipError as error:
            missing.append(f"{name}, {label}: {error}")
    with task(on_progress, f"{source.name}, {label}", 2 * protocol.replications) as work:
        scores = score_rows(column.real, rows, features, protocol, source.parts, work.advance)
        try:
            scores[P2] = score_disjoint_halves(column.real, features, protocol, source.parts, work.advance)
        except ClipError as error:
            missing.append(f"{P2}, {label}: {error}")
    return scores


def clip_fid_cell(score: ClipFid) -> Cell:
    """A score as a table shows it, with its parts and further metrics as details."""
    parts = {f"FID of the {name} block alone": value.mean for name, value in score.parts.items()}
    details = {DETAIL_NAMES[name]: value.mean for name, value in score.details.items()}
    return Cell(score.clip_fid.mean, score.clip_fid.ci95, parts | details)


def _paper_block() -> Block:
    cells: dict[str, dict[str, Cell]] = {}
    figures = reported_figures("nerm", "2")
    for figure in figures:
        if figure.value is not None:
            cells.setdefault(figure.method, {})[framerate_label(figure.setting)] = Cell(figure.value, figure.ci95)
    return Block(
        title="Printed in the NeRM paper (HumanML3D)",
        columns=tuple(dict.fromkeys(framerate_label(figure.setting) for figure in figures)),
        rows=tuple(Row(f"{method} (paper)", "paper", found) for method, found in cells.items()),
        note=(
            "These numbers cannot be compared with ours: they are from another feature extractor on another data set, "
            "the paper does not say how many clips of which sizes it draws, how the extractor is used away from 20 fps "
            "or what the real set at a target framerate is, and at 20 fps it prints its Table 1's FID of whole motions "
            f"for every method. Source: {SOURCES['nerm']}."
        ),
    )


def _caption(columns: Sequence[ColumnSize], request: TableRequest) -> str:
    protocol = request.protocol
    seconds = [column.duration_seconds for column in columns]
    caption = (
        f"clip-FID ({VERSION}), lower is better: mean ± half the 95 % interval over {protocol.replications} "
        f"replications of N = {protocol.num_clips:,} random clips on each side, "
        f"split {request.split!r}{request.restriction}."
    )
    if request.low_pass_hz is not None:
        caption += f" Every set, the real one too, was low-passed at {request.low_pass_hz:g} Hz."
    if min(seconds) < SMALL_SECONDS:
        caption += (
            f" A small-scale run: the real sets hold {min(seconds) / 60:.1f} to {max(seconds) / 60:.1f} minutes of "
            "motion, so rows say how systems rank on this store and no more."
        )
    return caption


def _definition(columns: Sequence[ColumnSize], request: TableRequest) -> dict[str, Any]:
    protocol = asdict(request.protocol)
    kind = type(request.protocol.sizes).__name__
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
        "split": request.split,
        "where": request.where,
        "low_pass_hz": request.low_pass_hz,
    }


def _notes(columns: Sequence[ColumnSize]) -> tuple[str, ...]:
    sets = "; ".join(
        f"{column.label}: {column.num_sequences} sequences, {column.duration_seconds / 60:.1f} min"
        for column in columns
    )
    return (
        f"Real sets: {sets}.",
        "Columns hold different sequences, so numbers compare down a column, not along a row.",
        "clip-FID here has nothing to do with the FID of images on CLIP features.",
    )


def _sample_notes(columns: Sequence[ColumnSize], folders: Sequence[SampleFolder]) -> tuple[str, ...]:
    if not folders or len({column.num_sequences for column in columns}) == 1:
        return ()
    return (
        "A folder of samples enters every column with all its motions, but a column's real set holds the takes that "
        "are fast enough: where samples were made for other takes too, part of their score is what those do.",
    )
