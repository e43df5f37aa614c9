"""PA-HiRes' tables and figures: interpolation, in-betweening, extrapolation, and ablations of interpolation at ×4.

An ablation's variant is a cell: the mean of its runs, one for each seed.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import get_args

from eval.completion import interpolation, windows
from eval.completion.data_sets import DataSet, data_sets_of, open_clips, split_remark
from eval.completion.encoders import HOLD, INTERPOLATION, Completer, completer_of, trained_completers
from eval.completion.interpolation import CLIP_FRAMES, scale_label
from eval.completion.scores import Scope, Scores, blocks_of, shown_measure, with_pools
from eval.metrics.registry import find_metric
from eval.report.results import Block, Cell, Row
from eval.sets.motions import NoRealMotionError
from eval.tables.table import SOURCES, Content, EvalConfig, Reported, Table, mean_cells, printed_block, reported_figures
from motionkit.core.errors import MotionkitError
from motionkit.core.progress import task, tracked
from motionkit.edit.encoders import installed_encoders
from motionkit.store.reader import Store
from motionkit.training.ablations import Ablation, Variant, find_ablations
from motionkit.training.run import RunFolder, Task

METRICS = {
    "psnr": "PSNR (dB)",
    "ssim": "SSIM",
    "mpjpe_global": "MPJPE (cm)",
    "acceleration_error": "acceleration error (m/s²)",
}
WINDOW_METRICS = {"l2p": "L2P", "l2q": "L2Q", "npss": "NPSS"}
PRINTED_METRICS = {"psnr_db": "PSNR (dB)", "ssim": "SSIM"}
SMALL_TAKES = 100
PAHIRES = find_ablations("pahires")
STAGE = next(iter(PAHIRES.stages))
ABLATED_METRICS = ("psnr", "ssim", "acceleration_error")
ABLATED_SCALE = Fraction(4)
UNTRAINED = tuple(row for row in INTERPOLATION if row.name in ("SLERP", "cubic spline"))


# One data set's clips: their label, a remark on them, and what measures a row on them.
Clips = tuple[str, str, Callable[[Completer], Scores]]


def _scored(
    caption: str,
    clips_of: Callable[[DataSet], Clips],
    data_sets: Iterable[DataSet],
    completers: Sequence[Completer],
    config: EvalConfig,
) -> tuple[list[Scope], Content]:
    """Every row's scores on every data set that has takes, and a content without blocks; rows that fail are missing.

    Raises `NoRealMotionError` if no data set has takes.
    """
    remarks, without, scopes = [], [], []
    for data_set in data_sets:
        try:
            with task(config.on_progress, f"clips of {data_set.name}"):
                label, remark, measure = clips_of(data_set)
        except NoRealMotionError as error:
            without.append(f"{data_set.label}: {error}")
            continue
        rows: dict[str, Scores] = {}
        for each in tracked(config.on_progress, label, completers, len(completers)):
            with config.missing.skipping(f"{label}, {each.name}", (MotionkitError, ValueError)):
                rows[each.name] = measure(each)
        scopes.append(Scope(label, data_set.fps, rows))
        remarks.append(remark)
    if not scopes:
        raise NoRealMotionError("; ".join(without))
    config.missing.add(*without)
    provenance = {
        "weights_sha256": {each.name: each.weights_sha256 for each in completers if each.trained},
        "trained": {each.name: each.facts for each in completers if each.trained},
    }
    notes = (*remarks, "± is half the 95 % interval over takes.")
    content = Content(f"{caption} S{config.real[1:]}.", blocks=(), notes=notes, provenance=provenance)
    return with_pools(scopes), content


def _interpolated(
    store: Store,
    data_sets: Iterable[DataSet],
    scales: Sequence[Fraction],
    completers: Sequence[Completer],
    config: EvalConfig,
) -> tuple[list[Scope], Content]:
    """Interpolation at some scales on every data set that has clips, and a content without blocks."""

    def clips_of(data_set: DataSet) -> Clips:
        clips = open_clips(store, data_set, config.split, config.where, CLIP_FRAMES, CLIP_FRAMES)
        num_takes = len(set(clips.takes))
        remark = f"{data_set.label}: {len(clips.takes):,} clips of {num_takes:,} takes"
        try:
            training = open_clips(store, data_set, "train", None, CLIP_FRAMES, CLIP_FRAMES)
        except NoRealMotionError:
            training, remark = clips, f"{remark}, whose deviations stand for those of training clips"
        remark += (
            f"; left out: {clips.num_short:,} shorter than {clips.num_frames} frames, {clips.num_other_fps:,} at other "
            f"framerates; {split_remark(store, clips, config.split)}"
        )
        if num_takes < SMALL_TAKES:
            remark += f". **Small scale**: fewer than {SMALL_TAKES} takes say little about others."
        measure = partial(interpolation.measure_interpolation, clips, interpolation.measure_scale(training), scales)
        return data_set.label, remark, measure

    caption = (
        f"Of every clip {interpolation.NUM_GIVEN} real frames are given, all frames between them are predicted and "
        "scored; no frame of the truth is interpolated."
    )
    scopes, content = _scored(caption, clips_of, data_sets, completers, config)
    definition = {
        "given_frames": interpolation.NUM_GIVEN,
        "clip_frames": CLIP_FRAMES,
        "psnr_ceiling_db": interpolation.CEILING_DB,
    }
    return scopes, replace(content, definition=definition)


def interpolation_table(scales: Sequence[Fraction], table: str, config: EvalConfig, store: Store) -> Content:
    """All rows of all data sets of the store, and which are not available.

    Raises `NoRealMotionError` if no data set has takes, and `UsageError` for an unknown encoder.
    """
    trained = trained_completers("interpolation", config.run, config.encoders, config.missing)
    completers = [*INTERPOLATION, *trained]
    scopes, content = _interpolated(store, data_sets_of(store, config.fps), scales, completers, config)
    labels = tuple(map(scale_label, scales))
    further = map(find_metric, ("rotation_angle_error", "velocity_error", "jerk_error"))
    titles = {metric.name: metric.title + (f" ({metric.unit})" if metric.unit else "") for metric in further}
    blocks = blocks_of(scopes, completers, labels, METRICS, {"mpjpe_global": titles})
    return replace(content, blocks=(*blocks, *_printed(table, labels)))


def ablation_table(ablation: Ablation, config: EvalConfig, store: Store) -> Content:
    """Scores of the runs RUN-VARIANT on every data set, at their training framerate.

    Raises `UsageError` without a run's name, or if none of the runs is trained, and as `interpolation_table`.
    """
    runs = PAHIRES.trained_runs(ablation.table, config.run, STAGE)
    assert config.run is not None
    command = PAHIRES.command(ablation.table, config.run)
    lacking = [variant.name for variant, by_seed in runs.items() if not by_seed]
    config.missing.add(*(f"{name}: not trained ({command} --only {name})" for name in lacking))
    folders = [run for by_seed in runs.values() for run in by_seed.values()]
    training = [run.stage(STAGE).read_config()["config"]["training"] for run in folders]
    rates = {Fraction(each["fps"]) for each in training}
    completers = [replace(completer_of(PAHIRES.paper, run.path), name=run.path.name) for run in folders]
    data_sets = [each for each in data_sets_of(store) if each.fps in rates]
    if not data_sets:
        raise NoRealMotionError(f"no data set stands at the framerates of training: {', '.join(map(str, rates))}")
    scopes, content = _interpolated(store, data_sets, (ABLATED_SCALE,), [*UNTRAINED, *completers], config)
    steps = sorted({f"{each['schedule']['steps']:,} steps, form {each['answer']['form']}" for each in training})
    blocks = [_ablated(scope, metric, runs) for scope in scopes for metric in ABLATED_METRICS]
    changes = {f"{each.label}; {each.column}": list(each.change) for each in ablation.variants}
    return replace(
        content,
        caption=f"One setting changes, after {' or '.join(steps)}, at {scale_label(ABLATED_SCALE)}. {content.caption}",
        blocks=(*blocks, *_printed(ablation.table)),
        definition={**content.definition, "variants": changes},
        runs=tuple(run.path for run in folders),
        provenance={"runs": {run.path.name: run.stage(STAGE).read_summary() for run in folders}, **content.provenance},
    )


def _ablated(scope: Scope, metric: str, runs: Mapping[Variant, Mapping[int, RunFolder]]) -> Block:
    """One metric of a data set: untrained rows, which are the same in every column, and the variants."""

    def cell(name: str) -> Cell:
        return Cell(scope.number(name, metric, scale_label(ABLATED_SCALE)).value)

    columns = tuple(dict.fromkeys(variant.column for variant in runs))
    rows = [
        Row(f"{each.name}, not trained", "reference", dict.fromkeys(columns, cell(each.name))) for each in UNTRAINED
    ]
    cells: dict[str, dict[str, Cell]] = {}
    for variant, by_seed in runs.items():
        names = [run.path.name for run in by_seed.values() if run.path.name in scope.rows]
        means = mean_cells([{variant.column: cell(name)} for name in names])
        cells.setdefault(variant.label, {}).update(means)
    rows += [Row(label, "ours", by_column) for label, by_column in cells.items() if by_column]
    lower = find_metric(metric).higher_is_better is False
    shown = (shown_measure(metric),)
    return Block(f"{scope.label}: {METRICS[metric]}", columns, tuple(rows), lower, scope.note, metrics=shown)


def _printed(table: str, columns: tuple[str, ...] = ()) -> list[Block]:
    """The paper's figures by data set and metric; none of its figures 5 and 6, which it draws without numbers.

    A setting is `x2.4`, or of the ablation `x4;terms=16;shared=no`.
    """

    def row(figure: Reported) -> str:
        shared = "shared" if "shared=yes" in figure.setting else "own parameters"
        return f"{shared if ablated else figure.method} (paper)"

    def column(figure: Reported) -> str:
        return f"ζ = {figure.setting.split('terms=')[1].split(';')[0]}" if ablated else figure.setting.replace("x", "×")

    ablated, figures = not columns, reported_figures("pahires", table)
    return [
        printed_block(
            f"Printed in the PA-HiRes paper, {data_set}: {PRINTED_METRICS[metric]}",
            [figure for figure in figures if (figure.dataset, figure.metric) == (data_set, metric)],
            column,
            name=row,
            columns=columns,
            lower_is_better=False,
            note=f"Undefined pose vector, range and clips; trained for 1,000 epochs. Source: {SOURCES['pahires']}.",
        )
        for data_set, metric in dict.fromkeys((figure.dataset, figure.metric) for figure in figures)
        if metric in PRINTED_METRICS
    ]


@dataclass(frozen=True)
class WindowTable:
    """A table over windows of 65 frames at 30 fps: its task, questions, metrics with titles, and untrained rows."""

    task: Task
    version: str
    questions: tuple[windows.Question, ...]
    metrics: Mapping[str, str]
    details: Mapping[str, Mapping[str, str]]
    rows: tuple[Completer, ...]
    caption: str


_BENCHMARK_ROWS = {
    "hold": ("zero velocity", "the last given pose"),
    "SLERP": ("interpolation (SLERP)", "the benchmark's own interpolation: local great arcs, root on a line"),
}
INBETWEENING = WindowTable(
    "inbetweening",
    windows.INBETWEENING_VERSION,
    windows.GAPS,
    WINDOW_METRICS,
    {"l2p": {"mpjpe_global": "MPJPE (cm)"}, "l2q": {"l2q_as_signed": "L2Q, signs as they come"}},
    tuple(
        replace(row, name=name, note=note)
        for row in INTERPOLATION
        for name, note in [_BENCHMARK_ROWS.get(row.name, (row.name, row.note))]
    ),
    "10 past frames and the first future one are given, the n frames between them asked for and scored (LaFAN1's "
    "protocol, 30 fps).",
)
EXTRAPOLATION = WindowTable(
    "extrapolation",
    windows.EXTRAPOLATION_VERSION,
    windows.CONTINUATIONS,
    {"mpjpe_global": "MPJPE (cm)", **WINDOW_METRICS},
    {},
    (
        replace(HOLD, name="zero velocity", note="the nearest given pose"),
        replace(UNTRAINED[0], name="constant velocity", note="joints and root go on as between the last two poses"),
    ),
    "30 frames (one second) are given, the n frames after or before them asked for and scored.",
)


def window_table(table: WindowTable, config: EvalConfig, store: Store) -> Content:
    """Every row of every data set at 30 fps; `--fps` is ignored.

    Raises `NoRealMotionError` if the store has no windows, and `UsageError` for an unknown encoder.
    """
    trained = trained_completers(table.task, config.run, config.encoders, config.missing)
    completers = [*table.rows, *trained]

    def clips_of(data_set: DataSet) -> Clips:
        if data_set.value == "lafan1":
            of_set = windows.lafan1_windows(store)
        else:
            of_set = windows.data_set_windows(store, data_set, config.split, config.where)
        measure = partial(windows.measure_windows, of_set, table.questions)
        return of_set.name, f"{of_set.name}: {of_set.remark}", measure

    data_sets = (each for each in data_sets_of(store) if each.fps == windows.FPS)
    scopes, content = _scored(table.caption, clips_of, data_sets, completers, config)
    columns = tuple(question.label for question in table.questions)
    printed = _printed_inbetweening(columns) if table is INBETWEENING else []
    blocks = blocks_of(scopes, completers, columns, table.metrics, table.details)
    return replace(content, blocks=(*blocks, *printed))


def _printed_inbetweening(columns: tuple[str, ...]) -> list[Block]:
    """Published figures for LaFAN1: the paper's, and those of the rows' own authors."""
    sources = {"pahires": "3", "lafan1": "benchmark", "delta-interp": "benchmark", "ts-former": "benchmark"}
    whose = {"pahires": "PA-HiRes paper", "lafan1": "benchmark"}
    figures = [figure for paper, table in sources.items() for figure in reported_figures(paper, table)]
    note = f"Sources: {'; '.join(SOURCES[paper] for paper in sources)}."
    return [
        printed_block(
            f"Printed for LaFAN1: {title}",
            [figure for figure in figures if figure.metric == metric],
            lambda figure: figure.setting,
            name=lambda figure: f"{figure.method} ({whose.get(figure.paper, 'its authors')})",
            columns=columns,
            note=note,
        )
        for metric, title in WINDOW_METRICS.items()
    ]


_table = partial(Table, "pahires")
_ENCODERS = {task: partial(installed_encoders, task) for task in get_args(Task)}
TABLE_1, TABLE_2 = (
    _table(
        number,
        title,
        interpolation.VERSION,
        partial(interpolation_table, scales, number),
        shown=_ENCODERS["interpolation"],
    )
    for number, title, scales in (
        ("1", "interpolation at integer scales", interpolation.INTEGER_SCALES),
        ("2", "interpolation at non-integer scales", interpolation.OTHER_SCALES),
    )
)
TABLE_3, TABLE_EXTRAPOLATION = (
    _table(number, title, each.version, partial(window_table, each), shown=_ENCODERS[each.task], task=result)
    for number, title, each, result in (
        ("3", "in-betweening (LaFAN1's protocol)", INBETWEENING, ""),
        ("extrapolation", "forwards and backwards", EXTRAPOLATION, "pahires-extrapolation"),
    )
)
TABLE_4, FIGURE_5, FIGURE_6 = (
    _table(number, PAHIRES.tables[number].title, interpolation.VERSION, partial(ablation_table, PAHIRES.tables[number]))
    for number in ("4", "figure5", "figure6")
)
