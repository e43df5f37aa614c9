"""One framerate of a table: the real set, its baselines, models' and other systems' sets, and their clip-FID."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

from eval.clip_fid.score import ClipError, Comparison
from eval.config import EvalConfig
from eval.detail import LEAST_FPS, RealDetail
from eval.detail import VERSION as DETAIL_VERSION
from eval.metrics.number import Number
from eval.report.results import Block, Cell, Row, pairs_of
from eval.sample_folder.folder import takes_of_samples
from eval.sets.motions import (
    NoRealMotionError,
    RealMotion,
    Window,
    is_framed,
    low_passed,
    planted_set,
    sample_fields,
    upsample_as_vectors,
    upsampled,
)
from eval.sets.sets import REAL, TRAINING_TAKES, Missing, RowId, SampleSet, Variant
from motionkit.core.progress import task
from motionkit.fields.motion_field import MotionField

COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
LOW_FPS = Fraction(20)
P1 = RowId(REAL.system, Variant.INDEPENDENT_DRAWS)
P2 = RowId(REAL.system, Variant.HALVES)
SLERP = RowId(REAL.system, Variant.KEPT_AT_20)
VECTORS = RowId(REAL.system, Variant.KEPT_AS_VECTORS)
TRAINING = RowId(TRAINING_TAKES.system, Variant.AS_GENERATOR)
REFERENCES = (P1, P2, TRAINING, SLERP, VECTORS)
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
NOT_SO_FAST = "no generated motion is for a sequence this fast"
MOTIONS, TAKES = "motions", "takes"
DRAWING = "± of the drawing of clips alone"
LOWEST, HIGHEST = "real takes, lowest (2.5 %)", "real takes, highest (97.5 %)"
OUTSIDE = "*"
DETAIL_NOTE = (
    "T: how far power at 12 to 27 Hz comes when slow motion predicts, as a share of real motion's. Hz: power in that "
    "band, in dB relative to real motion's. R: change of bone lengths > 8 Hz, in mm. Read each by itself, none is a "
    f"score. The first two rows are the range of random halves of the real takes beside the other halves; {OUTSIDE} "
    "marks what lies outside of it (of R, only what lies above: bones of a body do not change). Intervals over takes "
    "are in the JSON."
)

# Models' motions for stretches of real sequences.
ModelFields = Mapping[RowId, Mapping[Window, MotionField]]


def label(fps: Fraction | str) -> str:
    """`20 fps`, `12.5 fps` for a framerate, or for the paper's `20fps`."""
    if isinstance(fps, Fraction):
        return f"{float(fps):.5g} fps"
    return f"{fps.removesuffix('fps').strip()} fps"


@dataclass(frozen=True, eq=False)
class Column:
    """All sets of one framerate; `train` is None without training motion.

    `systems` are the rows that models generated at this framerate, and those of samples. Rows in `subset_sizes` are
    scored by random subsets of that many sequences.
    """

    fps: Fraction
    real: SampleSet
    rows: Mapping[RowId, SampleSet]
    train: SampleSet | None
    systems: tuple[RowId, ...] = ()
    subset_sizes: Mapping[RowId, int] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Its name in a table."""
        return label(self.fps)

    @property
    def others(self) -> dict[str, SampleSet]:
        """The rows that are not baselines of the real set, by name."""
        return {str(row): samples for row, samples in self.rows.items() if row not in REFERENCES}

    def low_passed(self, cutoff_hz: float | None) -> "Column":
        """The same column with every set low-passed; unchanged without a cut-off."""
        if cutoff_hz is None:
            return self
        sets = {id(each): each for each in (self.real, *self.rows.values(), *filter(None, [self.train]))}
        smooth = {key: low_passed(each, cutoff_hz) for key, each in sets.items()}
        return replace(
            self,
            real=smooth[id(self.real)],
            rows={row: smooth[id(samples)] for row, samples in self.rows.items()},
            train=None if self.train is None else smooth[id(self.train)],
        )


def real_column(fps: Fraction, real: RealMotion, train: RealMotion) -> Column:
    """The real set of one framerate with no row but independent draws of itself.

    Raises `NoRealMotionError` where too few sequences are as fast.
    """
    reference = real.at(fps)
    try:
        training = train.at(fps)
    except NoRealMotionError:
        training = None
    return Column(fps, reference, {P1: reference}, training)


def make_column(fps: Fraction, real: RealMotion, train: RealMotion, fields: ModelFields, config: EvalConfig) -> Column:
    """All sets of one framerate: baselines, models' and samples' motions as far as there are any.

    Raises `NoRealMotionError` if too few sequences are as fast.
    """
    column = real_column(fps, real, train)
    reference, rows = column.real, dict(column.rows)
    if fps >= LOW_FPS:
        low = real.at(LOW_FPS)
        place = {sequence_id: index for index, sequence_id in enumerate(low.sequence_ids)}
        low = low.select([place[sequence_id] for sequence_id in reference.sequence_ids])
        rows[SLERP] = upsampled(low, fps, str(SLERP))
        rows[VECTORS] = upsample_as_vectors(low, fps, str(VECTORS))
    systems = []
    for row, samples in generated_at(fields, reference, fps, config.missing).items():
        rows[row] = samples
        if row.variant is not Variant.AS_IS:
            continue
        systems.append(row)
        framed = is_framed(fields[row])
        coarse_row = RowId(row.system, Variant.AS_VECTORS if framed else Variant.UPSAMPLED)
        coarse = sample_fields(fields[row], reference.sequence_ids, LOW_FPS, str(coarse_row))
        if coarse is not None and fps >= LOW_FPS:
            bring = upsample_as_vectors if framed else upsampled
            rows[coarse_row] = bring(coarse, fps, str(coarse_row))
    others = samples_at(real, fps, config)
    rows |= others
    sizes = {}
    if column.train is not None and train is not real:
        takes = [each.num_takes for row, each in rows.items() if row not in REFERENCES]
        rows[TRAINING] = column.train
        sizes[TRAINING] = min([*(takes or [reference.num_takes]), column.train.num_sequences])
    return replace(column, rows=rows, systems=(*systems, *others), subset_sizes=sizes)


def generated_at(fields: ModelFields, real: SampleSet, fps: Fraction, missing: Missing) -> dict[RowId, SampleSet]:
    """Every row of generated motion at a framerate, for the real sequences that there are at it."""
    rows = {}
    for row, own in fields.items():
        samples = sample_fields(own, real.sequence_ids, fps, str(row))
        if samples is None:
            missing.add(f"{row}, {label(fps)}: {NOT_SO_FAST}")
        else:
            rows[row] = samples
    return rows


def samples_at(real: RealMotion, fps: Fraction, config: EvalConfig) -> dict[RowId, SampleSet]:
    """Every folder's motions at a framerate, as they are and planted; only for takes as fast, if known.

    Raises `NoRealMotionError` if too few real sequences are as fast.
    """
    rows: dict[RowId, SampleSet] = {}
    for folder in config.sample_folders:
        with task(config.on_progress, f"{folder.name}, {label(fps)}"):
            every = folder.at(fps)
        found = takes_of_samples(folder, real).of_column(every, real.at(fps))
        if found is None:
            config.missing.add(f"{folder.name}, {label(fps)}: {NOT_SO_FAST}")
        else:
            rows |= {RowId(folder.name): found, RowId(folder.name, Variant.PLANTED): planted_set(found)}
    return rows


# Differences of two rows with paired intervals.
Pairs = Mapping[tuple[RowId, RowId], Number]


def score_column(
    comparison: Comparison,
    rows: Mapping[RowId, SampleSet],
    missing: Missing,
    on_replication: Callable[[], None] = lambda: None,
    subset_sizes: Mapping[RowId, int] | None = None,
    *,
    halves: bool = True,
) -> tuple[dict[RowId, Cell], Pairs]:
    """A cell for each row that fits the largest clips, and differences of rows.

    With `halves` one cell more, of disjoint halves of the takes (P2).
    """
    name, sizes = label(comparison.real.fps), subset_sizes or {}
    fitting = {}
    for row, samples in rows.items():
        with missing.skipping(f"{row}, {name}", (ClipError,)):
            comparison.protocol.check_lengths(samples)
            fitting[row] = samples
    scores = comparison.scores(fitting, on_replication, sizes)
    cells = {row: _cell(score, rows[row], sizes.get(row)) for row, score in scores.items()}
    if halves:
        with missing.skipping(f"{P2}, {name}", (ClipError,)):
            half = comparison.real.num_sequences // 2
            cells[P2] = _cell(comparison.disjoint_halves(on_replication), comparison.real, half)
    own = [row for row in scores if row not in REFERENCES]
    pairs = {pair: scores[pair[0]].less(scores[pair[1]]) for pair in pairs_of(own, {SLERP} & scores.keys())}
    return cells, {pair: difference for pair, difference in pairs.items() if difference is not None}


def _cell(score: Number, samples: SampleSet, subset: int | None) -> Cell:
    """A score as a cell; further metrics and the size of its sets are details.

    It has no interval if takes cannot be resampled (a single take). `subset` is the number of sequences scored at once,
    if not all.
    """
    details = {
        "FID_∞" if name == "fid_infinity" else "KID" if name == "kid" else name: value
        for name, value in score.details.items()
    }
    sizes = {MOTIONS: subset or samples.num_sequences, TAKES: subset or samples.num_takes}
    interval = score.ci95 if score.resampled or subset else None
    return Cell(score.value, interval, {**details, DRAWING: score.drawing, **sizes})


def detail_blocks(
    real: SampleSet,
    train: SampleSet | None,
    rows: Mapping[RowId, SampleSet],
    notes: Mapping[RowId, str],
    config: EvalConfig,
) -> list[Block]:
    """The detail profile of rows at 40 fps or more; none below, without training motion, or of frozen real motion."""
    blocks: list[Block] = []
    if train is None or real.fps < LEAST_FPS:
        return blocks
    name = f"detail, {label(real.fps)}"
    with task(config.on_progress, name), config.missing.skipping(name, (ClipError,)):
        detail = RealDetail.of(real, train, config.seed)
        cells = {row: detail_cells(detail, samples) for row, samples in rows.items() if row not in (REAL, P1)}
        if cells:
            blocks.append(detail_block(detail, cells, {**notes, TRAINING: "all of them"}))
    return blocks


def detail_cells(detail: RealDetail, samples: SampleSet) -> dict[str, Cell]:
    """The figures of one set's profile, marked where they lie outside of what real takes show."""
    return {
        name: Cell(
            figure.value,
            details=dict(zip(("2.5 % over takes", "97.5 % over takes"), figure.interval, strict=True)),
            mark="" if figure.is_real else OUTSIDE,
        )
        for name, figure in detail.profile(samples).figures.items()
    }


def detail_block(detail: RealDetail, cells: Mapping[RowId, Mapping[str, Cell]], notes: Mapping[RowId, str]) -> Block:
    """The ranges of real takes, then a row of `detail_cells` for each set."""
    names, rows = tuple(next(iter(cells.values()))), []
    if detail.ranges is not None:
        for name, bounds in zip((LOWEST, HIGHEST), detail.ranges.tolist(), strict=True):
            rows.append(Row(name, "reference", dict(zip(names, map(Cell, bounds), strict=True))))
    for row, figures in cells.items():
        rows.append(Row(str(row), "reference" if row in REFERENCES else "ours", figures, notes.get(row, "")))
    note = f"{DETAIL_NOTE} Real motion keeps {detail.real_slope:.2f} of the slope that the prediction was fitted with."
    provenance = {"version": DETAIL_VERSION, "real_slope": detail.real_slope}
    title = f"Detail profile, {label(detail.real.fps)}"
    return Block(title, names, tuple(rows), note=note, provenance=provenance)
