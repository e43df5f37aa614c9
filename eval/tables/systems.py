"""What tables have rows of: real motion and its baselines, a run's models and encoders, other systems' samples."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from eval.clip_fid.score import KINEMATIC, ClipError, Comparison, FeatureSource
from eval.detail import LEAST_FPS, RealDetail
from eval.detail import VERSION as DETAIL_VERSION
from eval.metrics.intervals import Number
from eval.report.results import Block, Cell, Row, pairs_of
from eval.sample_folder.folder import samples_of_takes, takes_of_samples
from eval.sets import motions
from eval.sets.motions import NoRealMotionError, RealMotion, Window
from eval.sets.sets import REAL, TRAINING_TAKES, Missing, RowId, SampleSet, Variant, check_sample_names
from eval.tables.table import EvalConfig, name_and_fps
from motionkit.core.errors import DamagedFileError, UsageError, counted
from motionkit.core.progress import task, tracked
from motionkit.edit.encoders import installed_encoders
from motionkit.fields.detail import detailed
from motionkit.fields.motion_field import MotionEncoder, MotionField
from motionkit.generate.models import GenerativeModel, installed_models
from motionkit.store.reader import Store
from motionkit.training.detail import load_detail
from motionkit.training.run import Loader, RunError, RunFolder

COLUMNS = tuple(Fraction(rate) for rate in (20, 40, 60, 100, 120))
LOW_FPS = Fraction(20)
P1 = RowId(REAL.system, Variant.INDEPENDENT_DRAWS)
P2 = RowId(REAL.system, Variant.HALVES)
SLERP = RowId(REAL.system, Variant.KEPT_AT_20)
VECTORS = RowId(REAL.system, Variant.KEPT_AS_VECTORS)
TRAINING = RowId(TRAINING_TAKES.system, Variant.AS_GENERATOR)
TRAINING_CUT = RowId(TRAINING_TAKES.system, Variant.CUT)
REFERENCES = (P1, P2, TRAINING, TRAINING_CUT, SLERP, VECTORS)
ROW_NOTES = {
    P1: "two draws from the same takes: what sampling alone leaves",
    P2: "takes of one half against takes of the other, few against few; ± is of a single split",
    TRAINING: "random subsets of as many takes as the row with the fewest: what a generator that is real motion scores",
    TRAINING_CUT: "the same, each cut at random to the duration of a generated motion: equally much real motion",
    SLERP: "joint rotations on great arcs, the root on straight lines: the fair way to upsample",
    VECTORS: "humanml3d vectors interpolated with per-frame velocities unscaled: a handicap of the procedure",
}
NOT_SO_FAST = "no generated motion is for a sequence this fast"
MOTIONS, TAKES = "motions", "takes"
DRAWING = "± of the drawing of clips alone"
LOWEST, HIGHEST = "real takes, lowest (2.5 %)", "real takes, highest (97.5 %)"
OUTSIDE = "*"
DETAIL_NOTE = (
    "T: timing, as a share of real motion's. Hz: power in that band, in dB relative to real motion's. R: change of "
    f"bone lengths > 8 Hz, in mm. {OUTSIDE} marks what lies outside of the range of random halves of the real takes."
)

T = TypeVar("T")
# Models' motions for windows of real sequences.
ModelFields = Mapping[RowId, Mapping[Window, MotionField]]


def label(fps: Fraction | str) -> str:
    """`20 fps`, `12.5 fps` for a framerate, or for the paper's `20fps`."""
    return f"{float(fps):.5g} fps" if isinstance(fps, Fraction) else fps.replace("fps", " fps")


@dataclass(frozen=True, eq=False)
class Trained(Generic[T]):
    """A loader's object from a run, loaded on first use."""

    loader: Loader[T]
    run: Path

    @cached_property
    def loaded(self) -> T:
        """The model; raises what loading it raises."""
        return self.loader.load(self.run)

    @property
    def note(self) -> str:
        """How a model was trained, by its stages' summaries: steps, parameters, processor time, framerate."""
        efforts = {name: RunFolder(self.run).stage(name).effort() for name in self.loader.stages}
        facts = {
            name: ", ".join(f"{value} {'of ' * (fact == 'processor time')}{fact}" for fact, value in effort.items())
            for name, effort in efforts.items()
        }
        notes = [f"{name}: {text}" for name, text in facts.items() if text]
        model: Any = self.loaded
        knows = ", knows no texts and no actions" if motions.is_unconditional(model) else ""
        return "; ".join((*notes, f"trained at up to {float(model.max_training_fps):g} fps{knows}")) if notes else ""


def trained_models(run: Path | None, missing: Missing) -> dict[str, Trained[GenerativeModel]]:
    """The installed models in a run by their row names; those that it lacks are missing, with what trains them.

    Without a run there are none, and none is missing.
    """
    models: dict[str, Trained[GenerativeModel]] = {}
    if run is None:
        return models
    for loader in installed_models().values():
        with missing.skipping(loader.title, raising=(DamagedFileError,)):
            if not run.is_dir():
                raise RunError(f"there is no run {str(run)!r} ({loader.train_command(run)})")
            if not loader.begun_in(run):
                raise RunError(f"run {run.name!r} has none ({loader.train_command(run)})")
            model = Trained(loader, run)
            if (name := model.loaded.name) in models:
                raise RunError(f"another model of the run is called {name!r} too")
            models[name] = model
    return models


def require_models(run: Path | None, what: str, missing: Missing) -> dict[str, Trained[GenerativeModel]]:
    """As `trained_models`; raises `UsageError` without a run, `RunError` if it holds no model."""
    if run is None:
        raise UsageError(f"{what} needs trained systems: --run NAME (motionkit train --for {what.replace(' ', ':')})")
    models = trained_models(run, missing)
    if not models:
        begun = any(loader.begun_in(run) for loader in installed_models().values())
        why = "; ".join(missing.lines) if begun else f"motionkit train --for table:2 --run {run.name}"
        raise RunError(f"{str(run)!r} holds no trained system: {why}")
    return models


def trained_reconstructors(run: Path) -> dict[str, Trained[MotionEncoder]]:
    """The installed encoders in a run that reconstruct windows of motion, by name.

    Raises `RunError` if there is none, and what loading them raises.
    """
    loaders = installed_encoders("reconstruction").values()
    held = [Trained(loader, run) for loader in loaders if loader.begun_in(run)]
    if not held:
        commands = " or ".join(loader.train_command(run) for loader in loaders) or "none is installed"
        raise RunError(f"run {run.name!r} holds no model that reconstructs windows of motion: {commands}")
    return {each.loaded.name: each for each in held}


def generated_fields(config: EvalConfig, real: SampleSet) -> tuple[ModelFields, dict[str, str]]:
    """Motions that each model of the run generates for the captions and durations of a real set.

    As generated, planted, and, if the run has a trained detail stage and the model is continuous in time, planted with
    detail; and each model's `Trained.note` by its name. Raises `UsageError` for samples named like one of these rows.
    """
    run, most, draws = config.run, config.max_motions, config.draws
    models = trained_models(run, config.missing)
    check_sample_names({name_and_fps(name)[0] for name in config.samples}, models)
    detail = load_detail(run) if run is not None and RunFolder(run).stage("detail").is_complete else None
    rows: dict[RowId, dict[Window, MotionField]] = {}
    for name, trained in tracked(config.on_progress, "systems", models.items(), len(models)):
        with config.missing.skipping(name):
            windows = motions.windows_of(real, trained.loaded.max_duration_seconds)
            with task(config.on_progress, f"generating {name}", draws * min(len(windows), most)) as work:
                fields = motions.generate_fields(
                    trained.loaded, windows, config.seed, most, draws=draws, on_motions=work.advance
                )
            if not motions.is_framed(fields):
                fields = {window: motions.remembering(field) for window, field in fields.items()}
            standing = motions.planted_fields(fields)
            rows |= {RowId(name): fields, RowId(name, Variant.PLANTED): standing}
            if detail is not None and not motions.is_framed(fields):
                rows[RowId(name, Variant.DETAILED)] = {
                    window: detailed(field, detail, seed=config.seed, number=number)
                    for number, (window, field) in enumerate(standing.items())
                }
    return rows, {name: model.note for name, model in models.items()}


@dataclass(frozen=True, eq=False)
class Column:
    """All sets of one framerate; `train` is None without training motion.

    Rows in `subset_sizes` are scored by random subsets of that many sequences.
    """

    fps: Fraction
    real: SampleSet
    rows: Mapping[RowId, SampleSet]
    train: SampleSet | None
    subset_sizes: Mapping[RowId, int] = field(default_factory=dict)

    def comparison(self, source: FeatureSource, config: EvalConfig) -> Comparison:
        """The comparison with the real set on some features; raises `NoRealMotionError` without training motion."""
        if self.train is None:
            raise NoRealMotionError("the training split has no motion at this framerate")
        return source.comparison(self.real, self.train, config.clips)


def real_column(fps: Fraction, real: RealMotion, train: RealMotion) -> Column:
    """The real set of one framerate with no row but independent draws of itself.

    Raises `NoRealMotionError` where too few sequences are as fast.
    """
    training = None
    reference = real.at(fps)
    with suppress(NoRealMotionError):
        training = train.at(fps)
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
        rows[SLERP] = motions.upsampled(low, fps, str(SLERP))
        rows[VECTORS] = motions.upsample_as_vectors(low, fps, str(VECTORS))
    for row, samples in generated_at(fields, reference, fps, config.missing).items():
        rows[row] = samples
        if row.variant is Variant.AS_IS and fps >= LOW_FPS:
            framed = motions.is_framed(fields[row])
            coarse_row = RowId(row.system, Variant.AS_VECTORS if framed else Variant.UPSAMPLED)
            coarse = motions.sample_fields(fields[row], reference.sequence_ids, LOW_FPS, str(coarse_row))
            to_fps = motions.upsample_as_vectors if framed else motions.upsampled
            rows |= {} if coarse is None else {coarse_row: to_fps(coarse, fps, str(coarse_row))}
    rows |= samples_at(real, fps, config)
    if column.train is None or train is real:
        return Column(fps, reference, rows, column.train)
    generated = [each for row, each in rows.items() if row not in REFERENCES]
    fewest = min(generated or [reference], key=lambda each: each.num_takes)
    sizes = {TRAINING: min(fewest.num_takes, column.train.num_sequences)}
    rows[TRAINING] = column.train
    if generated:
        rng = np.random.default_rng((config.clips.seed, 7))
        rows[TRAINING_CUT] = column.train.cut(rng.choice(fewest.sequences.num_frames, column.train.num_sequences), rng)
        sizes[TRAINING_CUT] = sizes[TRAINING]
    return Column(fps, reference, rows, column.train, sizes)


def generated_at(fields: ModelFields, real: SampleSet, fps: Fraction, missing: Missing) -> dict[RowId, SampleSet]:
    """Every row of generated motion at a framerate, for the real sequences that there are at it."""
    rows = {row: motions.sample_fields(own, real.sequence_ids, fps, str(row)) for row, own in fields.items()}
    missing.add(*(f"{row}, {label(fps)}: {NOT_SO_FAST}" for row, samples in rows.items() if samples is None))
    return {row: samples for row, samples in rows.items() if samples is not None}


def samples_at(real: RealMotion, fps: Fraction, config: EvalConfig) -> dict[RowId, SampleSet]:
    """Every folder's motions at a framerate, as they are and planted; only for takes as fast, if known.

    Raises `NoRealMotionError` if too few real sequences are as fast.
    """
    rows: dict[RowId, SampleSet] = {}
    for folder in config.sample_folders:
        name, own_fps = name_and_fps(folder.name)
        if own_fps not in (None, fps):
            continue
        with task(config.on_progress, f"{folder.name}, {label(fps)}"):
            every = folder.at(fps)
        takes = takes_of_samples(folder, real)
        if any(takes) and "" in takes:
            config.missing.add(f"{folder.name}: {counted(takes.count(''), 'motion')} for none of the compared takes")
        samples = samples_of_takes(every, takes, real.at(fps))
        if samples is None:
            config.missing.add(f"{folder.name}, {label(fps)}: {NOT_SO_FAST}")
        else:
            rows |= {RowId(name): samples, RowId(name, Variant.PLANTED): motions.planted_set(samples)}
    return rows


def score_column(
    comparison: Comparison,
    rows: Mapping[RowId, SampleSet],
    missing: Missing,
    on_replication: Callable[[], None] = lambda: None,
    subset_sizes: Mapping[RowId, int] | None = None,
    *,
    halves: bool = True,
) -> tuple[dict[RowId, Cell], dict[tuple[RowId, RowId], Number]]:
    """A cell for each row that fits the largest clips, and differences of rows.

    With `halves` one cell more, of disjoint halves of the takes (P2).
    """

    def cell(score: Number, samples: SampleSet, subset: int | None) -> Cell:
        """It has no interval if takes cannot be resampled (a single take); `subset` sequences are scored at once."""
        titles = {"fid_infinity": "FID_∞", "kid": "KID"}
        details: dict[str, float | int] = {titles.get(name, name): value for name, value in score.details.items()}
        details[DRAWING] = score.drawing
        details |= {MOTIONS: subset or samples.num_sequences, TAKES: subset or samples.num_takes}
        return Cell(score.value, score.ci95 if score.resampled or subset else None, details)

    name, sizes = label(comparison.real.fps), subset_sizes or {}
    fitting = {}
    for row, samples in rows.items():
        with missing.skipping(f"{row}, {name}", (ClipError,)):
            comparison.protocol.check_lengths(samples)
            fitting[row] = samples
    scores = comparison.scores(fitting, on_replication, sizes)
    cells = {row: cell(score, rows[row], sizes.get(row)) for row, score in scores.items()}
    if halves:
        with missing.skipping(f"{P2}, {name}", (ClipError,)):
            half = comparison.real.num_sequences // 2
            cells[P2] = cell(comparison.disjoint_halves(on_replication), comparison.real, half)
    own = [row for row in scores if row not in REFERENCES]
    pairs = {pair: scores[pair[0]].less(scores[pair[1]]) for pair in pairs_of(own, {SLERP} & scores.keys())}
    return cells, {pair: difference for pair, difference in pairs.items() if difference is not None}


def detail_blocks(
    real: SampleSet, train: SampleSet | None, rows: Mapping[RowId, SampleSet], config: EvalConfig
) -> list[Block]:
    """The detail profile of rows at 40 fps or more; none below, without training motion, or of frozen real motion."""
    rows = {row: samples for row, samples in rows.items() if row not in (REAL, P1, TRAINING_CUT)}
    name, blocks = f"detail, {label(real.fps)}", list[Block]()
    if train is None or real.fps < LEAST_FPS or not rows:
        return blocks
    with task(config.on_progress, name), config.missing.skipping(name, (ClipError,)):
        detail = RealDetail.of(real, train, config.seed)
        figures = {row: detail.profile(each).figures for row, each in rows.items()}
        columns = tuple(next(iter(figures.values())))
        bounds = () if detail.ranges is None else zip((LOWEST, HIGHEST), detail.ranges.tolist(), strict=True)
        shown = [
            Row(bound, "reference", dict(zip(columns, map(Cell, values), strict=True))) for bound, values in bounds
        ]
        for row, by_column in figures.items():
            cells = {}
            for column, figure in by_column.items():
                interval = dict(zip(("2.5 % over takes", "97.5 % over takes"), figure.interval, strict=True))
                cells[column] = Cell(figure.value, details=interval, mark="" if figure.is_real else OUTSIDE)
            note = "all of them" if row == TRAINING else ""
            shown.append(Row(str(row), "reference" if row in REFERENCES else "ours", cells, note))
        slope = f"Real motion keeps {detail.real_slope:.2f} of the slope that the prediction was fitted with."
        provenance = {"version": DETAIL_VERSION, "real_slope": detail.real_slope}
        title, note = f"Detail profile, {label(real.fps)}", f"{DETAIL_NOTE} {slope}"
        blocks.append(Block(title, columns, tuple(shown), note=note, provenance=provenance))
    return blocks


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What generated motions are compared with: real motion by framerate, on the kinematic descriptor."""

    config: EvalConfig
    real: RealMotion
    train: RealMotion
    comparisons: Mapping[Fraction, Comparison]

    @classmethod
    def of(cls, store: Store, config: EvalConfig, rates: Sequence[Fraction]) -> "Yardstick":
        """The framerates at which there is real motion; raises `NoRealMotionError` if there is none."""
        real = motions.real_motion(store, config.split, config.where)
        train, comparisons = motions.training_motion(store, real), {}
        for fps in rates:
            with config.missing.skipping(f"clip-FID, {label(fps)}"):
                comparisons[fps] = real_column(fps, real, train).comparison(KINEMATIC, config)
        if not comparisons:
            raise NoRealMotionError("; ".join(config.missing.lines))
        return cls(config, real, train, comparisons)

    def floor_rows(self) -> list[Row]:
        """clip-FID of real motion with itself: independent draws (P1), and disjoint halves of the takes (P2)."""
        cells: dict[RowId, dict[str, Cell]] = {P1: {}, P2: {}}
        for fps, comparison in self.comparisons.items():
            for row, cell in score_column(comparison, {P1: comparison.real}, self.config.missing)[0].items():
                cells[row][label(fps)] = cell
        return [Row(str(row), "reference", by_column, ROW_NOTES[row]) for row, by_column in cells.items()]

    def windows(self, model: GenerativeModel) -> list[Window]:
        """Requests with the real sequences' durations and conditions."""
        return motions.windows_of(self.real.at(min(self.comparisons)), model.max_duration_seconds)

    def sets(self, row: RowId, fields: Mapping[Window, MotionField]) -> dict[Fraction, SampleSet]:
        """A row's motions at every framerate."""
        missing, by_fps = self.config.missing, self.comparisons.items()
        rows = {fps: generated_at({row: fields}, each.real, fps, missing) for fps, each in by_fps}
        return {fps: own[row] for fps, own in rows.items() if own}

    def clip_fid(self, row: RowId, sets: Mapping[Fraction, SampleSet]) -> dict[str, Cell]:
        """clip-FID of a row's motions by column."""
        cells: dict[str, Cell] = {}
        for fps, samples in sets.items():
            scored, _ = score_column(self.comparisons[fps], {row: samples}, self.config.missing, halves=False)
            cells |= {label(fps): cell for cell in scored.values()}
        return cells
