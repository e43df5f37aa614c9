"""One framerate of clip-FID: the real set, its baselines, models' and other systems' sets; and its cells."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

from eval.clip_fid.clips import ClipError, Protocol, check_lengths
from eval.clip_fid.features import Comparison, FeatureSource
from eval.metrics.number import Number
from eval.report.differences import pairs_of
from eval.report.results import Cell
from eval.sample_folder import SampleFolder
from eval.sample_folder.takes import takes_of_samples
from eval.sets.generated import Window, is_framed, sample_fields
from eval.sets.partial import PartialResult
from eval.sets.planted import planted_set
from eval.sets.real import NoRealMotionError, RealMotion
from eval.sets.row_ids import REAL, TRAINING_TAKES, RowId, Variant
from eval.sets.sets import SampleSet
from eval.sets.upsampled import low_passed, upsample_as_vectors, upsampled
from motionkit.core.progress import OnProgress, task
from motionkit.fields.motion_field import MotionField

LOW_FPS = Fraction(20)
P1 = RowId(REAL.system, Variant.INDEPENDENT_DRAWS)
P2 = RowId(REAL.system, Variant.HALVES)
SLERP = RowId(REAL.system, Variant.KEPT_AT_20)
VECTORS = RowId(REAL.system, Variant.KEPT_AS_VECTORS)
TRAINING = RowId(TRAINING_TAKES.system, Variant.AS_GENERATOR)
REFERENCES = (P1, P2, TRAINING, SLERP, VECTORS)

NOT_SO_FAST = "no generated motion is for a sequence this fast"
MOTIONS, TAKES = "motions", "takes"
DRAWING = "± of the drawing of clips alone"
DETAIL_NAMES = {
    "fid_infinity": "FID_∞",
    "kid": "KID",
    "precision": "precision",
    "recall": "recall",
    "density": "density",
    "coverage": "coverage",
}

# Models' motions for stretches of real sequences.
ModelFields = Mapping[RowId, Mapping[Window, MotionField]]


@dataclass(frozen=True, eq=False)
class Column:
    """All sets of one framerate; `train` is None without training motion.

    `models` are the rows that models generated at this framerate, `samples` those of other systems. Rows in
    `subset_sizes` are scored by random subsets of that many sequences.
    """

    fps: Fraction
    real: SampleSet
    rows: Mapping[RowId, SampleSet]
    train: SampleSet | None
    models: tuple[RowId, ...] = ()
    samples: tuple[RowId, ...] = ()
    subset_sizes: Mapping[RowId, int] = field(default_factory=dict)

    def comparison(self, source: FeatureSource, protocol: Protocol) -> Comparison:
        """The comparison that scores its rows; raises `MotionkitError` if it is not available."""
        if self.train is None:
            raise NoRealMotionError("the training split has no motion at this framerate")
        return source.comparison(self.real, self.train, protocol)

    @property
    def others(self) -> dict[str, SampleSet]:
        """The rows that are not baselines of the real set, by name."""
        return {str(row): samples for row, samples in self.rows.items() if row not in REFERENCES}

    @property
    def label(self) -> str:
        """Its name in a table."""
        return framerate_label(self.fps)

    @property
    def size(self) -> "ColumnSize":
        """Its summary, without the motions."""
        generated = {str(row): self.rows[row].num_sequences for row in self.models}
        return ColumnSize(self.fps, self.real.num_sequences, self.real.duration_seconds, generated)

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


@dataclass(frozen=True)
class ColumnSize:
    """How much real motion a column has, and how many motions each model generated for it."""

    fps: Fraction
    num_sequences: int
    duration_seconds: float
    num_generated: Mapping[str, int]

    @property
    def label(self) -> str:
        """Its name in a table."""
        return framerate_label(self.fps)


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


def make_column(
    fps: Fraction, real: RealMotion, train: RealMotion, fields: ModelFields, samples: Mapping[RowId, SampleSet]
) -> PartialResult[Column]:
    """All sets of one framerate, as far as models have motion for it.

    Raises `NoRealMotionError` if too few sequences are as fast.
    """
    column = real_column(fps, real, train)
    reference, rows = column.real, dict(column.rows)
    if fps >= LOW_FPS:
        low = _same_sequences(real.at(LOW_FPS), reference)
        rows[SLERP] = upsampled(low, fps, str(SLERP))
        rows[VECTORS] = upsample_as_vectors(low, fps, str(VECTORS))
    models, missing = [], []
    for row, own in fields.items():
        native = sample_fields(own, reference.sequence_ids, fps, str(row))
        if native is None:
            missing.append(f"{row}, {framerate_label(fps)}: {NOT_SO_FAST}")
            continue
        rows[row] = native
        if row.variant is not Variant.AS_IS:
            continue
        models.append(row)
        framed = is_framed(own)
        coarse_row = RowId(row.system, Variant.AS_VECTORS if framed else Variant.UPSAMPLED)
        coarse = sample_fields(own, reference.sequence_ids, LOW_FPS, str(coarse_row))
        if coarse is not None and fps >= LOW_FPS:
            bring = upsample_as_vectors if framed else upsampled
            rows[coarse_row] = bring(coarse, fps, str(coarse_row))
    rows |= samples
    sizes = {}
    if column.train is not None and train is not real:
        others = [each.num_takes for row, each in rows.items() if row not in REFERENCES]
        rows[TRAINING] = column.train
        sizes[TRAINING] = min([*(others or [reference.num_takes]), column.train.num_sequences])
    made = replace(column, rows=rows, models=tuple(models), samples=tuple(samples), subset_sizes=sizes)
    return PartialResult(made, tuple(missing))


@dataclass(frozen=True)
class ColumnScores:
    """A cell for each row, and differences of two rows with paired intervals."""

    cells: Mapping[RowId, Cell]
    differences: Mapping[tuple[RowId, RowId], Number]


def score_column(
    comparison: Comparison,
    rows: Mapping[RowId, SampleSet],
    on_replication: Callable[[], None] = lambda: None,
    subset_sizes: Mapping[RowId, int] | None = None,
    *,
    halves: bool = True,
) -> PartialResult[ColumnScores]:
    """A cell for each row that fits the largest clips, and with `halves` one for disjoint halves of the takes (P2)."""
    label = framerate_label(comparison.real.fps)
    missing: list[str] = []
    fitting = {}
    for row, samples in rows.items():
        try:
            check_lengths(samples, comparison.protocol)
            fitting[row] = samples
        except ClipError as error:
            missing.append(f"{row}, {label}: {error}")
    scores = comparison.scores(fitting, on_replication, subset_sizes)
    cells = {row: clip_fid_cell(score, rows[row], (subset_sizes or {}).get(row)) for row, score in scores.items()}
    if halves:
        try:
            half = comparison.real.num_sequences // 2
            cells[P2] = clip_fid_cell(comparison.disjoint_halves(on_replication), comparison.real, half)
        except ClipError as error:
            missing.append(f"{P2}, {label}: {error}")
    own = [row for row in scores if row not in REFERENCES]
    pairs = {pair: scores[pair[0]].less(scores[pair[1]]) for pair in pairs_of(own, {SLERP} & scores.keys())}
    differences = {pair: difference for pair, difference in pairs.items() if difference is not None}
    return PartialResult(ColumnScores(cells, differences), tuple(missing))


def clip_fid_cell(score: Number, samples: SampleSet, subset: int | None = None) -> Cell:
    """A score as a cell; further metrics and the size of its sets are details.

    It has no interval if takes cannot be resampled (a single take). `subset` is the number of sequences scored at once,
    if not all.
    """
    further = {DETAIL_NAMES[name]: value for name, value in score.details.items()}
    sizes = {MOTIONS: subset or samples.num_sequences, TAKES: subset or samples.num_takes}
    interval = score.ci95 if score.resampled or subset else None
    return Cell(score.value, interval, {**further, DRAWING: score.drawing, **sizes})


def samples_at(
    folders: Sequence[SampleFolder], real: RealMotion, fps: Fraction, on_progress: OnProgress
) -> PartialResult[dict[RowId, SampleSet]]:
    """Every folder's motions at a framerate, as they are and planted; only for takes as fast, if known.

    Raises `NoRealMotionError` if too few real sequences are as fast.
    """
    made: dict[RowId, SampleSet] = {}
    missing = []
    for folder in folders:
        with task(on_progress, f"{folder.name}, {framerate_label(fps)}", folder.num_motions) as work:
            every = folder.at(fps, work.advance)
        takes = takes_of_samples(folder, real)
        found = takes.of_column(every, real.at(fps))
        if found is None:
            missing.append(f"{folder.name}, {framerate_label(fps)}: {NOT_SO_FAST}")
        else:
            made |= {RowId(folder.name): found, RowId(folder.name, Variant.PLANTED): planted_set(found)}
    return PartialResult(made, tuple(missing))


def _same_sequences(low: SampleSet, reference: SampleSet) -> SampleSet:
    place = {sequence_id: index for index, sequence_id in enumerate(low.sequence_ids)}
    return low.select([place[sequence_id] for sequence_id in reference.sequence_ids])


def framerate_label(fps: Fraction | str) -> str:
    """`20 fps`, `12.5 fps` for a framerate, or for the paper's `20fps`."""
    if isinstance(fps, Fraction):
        return f"{float(fps):.5g} fps"
    return f"{fps.removesuffix('fps').strip()} fps"
