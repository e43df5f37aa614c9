"""PA-HiRes' tables and figures: interpolation, in-betweening, extrapolation, and ablations of interpolation at ×4.

An ablation's variant is a cell, whose entry names row and column: the mean of its runs, one for each seed. Blocks of
other starts show these one by one.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from statistics import fmean
from typing import Any

from eval.completion.data_sets import DataSet, NoTakesError, data_sets_of, open_clips, split_remark
from eval.completion.encoders import HOLD, INTERPOLATION, Completer, completer_of, trained_completers
from eval.completion.interpolation import (
    CEILING_DB,
    CLIP_FRAMES,
    INTEGER_SCALES,
    NUM_GIVEN,
    OTHER_SCALES,
    TIMED_METRICS,
    VERSION,
    measure_interpolation,
    measure_scale,
    scale_label,
)
from eval.completion.scores import Scope, Scores, Shown, blocks_of, shown_measure, with_pools
from eval.completion.windows import (
    EXTRAPOLATION_VERSION,
    FPS,
    INBETWEENING_VERSION,
    Question,
    continuations,
    data_set_windows,
    gaps,
    lafan1_windows,
    measure_windows,
)
from eval.metrics.registry import find_metric
from eval.report.results import Block, Cell, Row
from eval.tables.table import SOURCES, Content, EvalConfig, Reported, Table, cached, printed_block, reported_figures
from motionkit.core.errors import MotionkitError
from motionkit.core.progress import task
from motionkit.edit.encoders import installed_encoders
from motionkit.store.reader import Store
from motionkit.training.ablations import Ablation, find_ablations
from motionkit.training.run import RunFolder, Task, recorded_settings

METRICS = {
    "psnr": "PSNR (dB)",
    "ssim": "SSIM",
    "mpjpe_global": "MPJPE (cm)",
    "acceleration_error": "acceleration error (m/s²)",
}
WINDOW_METRICS = {"l2p": "L2P", "l2q": "L2Q", "npss": "NPSS"}
PRINTED_METRICS = {"psnr_db": "PSNR (dB)", "ssim": "SSIM"}
SMALL_TAKES = 100
SMALL = " **Small scale**: a data set of fewer than 100 takes says little about others."
INTERVALS = "± is half the 95 % interval over takes."
PAHIRES = find_ablations("pahires")
STAGE = next(iter(PAHIRES.stages))
ABLATED_METRICS = ("psnr", "ssim", "acceleration_error")
ABLATED_SCALE = Fraction(4)
UNTRAINED = tuple(row for row in INTERPOLATION if row.name in ("SLERP", "cubic spline"))


@dataclass(frozen=True, eq=False)
class Clips:
    """One data set's clips, what measures a row on them, and a remark on them."""

    label: str
    fps: Fraction
    num_takes: int
    remark: str
    measure: Callable[[Completer], Scores]


def _scored(
    name: str,
    data_sets: Iterable[DataSet],
    opened: Callable[[DataSet], Clips],
    terms: Mapping[str, Any],
    completers: Sequence[Completer],
    config: EvalConfig,
) -> tuple[list[Scope], list[Clips]]:
    """Every row's scores on every data set that has takes, cached for these terms; rows that fail are missing.

    Raises `NoTakesError` if no data set has takes.
    """
    found, without, scopes = [], [], []
    for data_set in data_sets:
        try:
            with task(config.on_progress, f"clips of {data_set.name}"):
                found.append(opened(data_set))
        except NoTakesError as error:
            without.append(f"{data_set.label}: {error}")
    if not found:
        raise NoTakesError("; ".join(without))
    config.missing.add(*without)
    for clips in found:
        rows: dict[str, Scores] = {}
        with task(config.on_progress, clips.label, len(completers)) as work:
            for each in completers:
                work.note(each.name)
                with config.missing.skipping(f"{clips.label}, {each.name}", (MotionkitError, ValueError)):
                    conditions = {"data set": clips.label, "split": config.split, "where": config.where}
                    key = {**terms, **conditions, "encoder": each.fingerprint}
                    rows[each.name] = cached(config.results, name, key, partial(clips.measure, each))
                work.advance()
        scopes.append(Scope(clips.label, clips.fps, rows))
    return with_pools(scopes, "clips"), found


def _encoders(completers: Sequence[Completer]) -> dict[str, Any]:
    """Provenance of a table's rows."""
    return {
        "encoders": {each.name: each.fingerprint for each in completers},
        "trained": {each.name: each.facts for each in completers if each.trained},
    }


def _interpolated(
    store: Store,
    data_sets: Iterable[DataSet],
    scales: Sequence[Fraction],
    completers: Sequence[Completer],
    config: EvalConfig,
) -> tuple[list[Scope], Content]:
    """Interpolation at some scales on every data set that has clips, and a content without blocks."""

    def opened(data_set: DataSet) -> Clips:
        clips = open_clips(store, data_set, config.split, config.where, CLIP_FRAMES, CLIP_FRAMES)
        remark = f"{data_set.label}: {clips.num_clips:,} clips of {clips.num_takes:,} takes"
        try:
            training = open_clips(store, data_set, "train", None, CLIP_FRAMES, CLIP_FRAMES)
        except NoTakesError:
            training, remark = clips, f"{remark}, whose deviations stand for those of training clips"
        left_out = {
            f"shorter than {clips.num_frames} frames": clips.num_short,
            "of framerates that are no multiple of the table's": clips.num_other_fps,
        }
        reasons = " and ".join(f"{count:,} {why}" for why, count in left_out.items() if count)
        remark += (f"; left out are {reasons}" if reasons else "") + f"; {split_remark(store, clips, config.split)}"
        measure = partial(measure_interpolation, clips, measure_scale(training), scales)
        return Clips(data_set.label, data_set.fps, clips.num_takes, remark, measure)

    terms = {"version": VERSION, "store": store.fingerprint, "scales": [str(each) for each in scales]}
    scopes, clips = _scored("interpolation", data_sets, opened, terms, completers, config)
    small = min(each.num_takes for each in clips) < SMALL_TAKES
    content = Content(
        caption=(
            f"Of every clip {NUM_GIVEN} real frames are given and all frames between them asked for; no frame of the "
            f"truth is interpolated. S{config.real[1:]}.{SMALL if small else ''}"
        ),
        blocks=(),
        definition={"given_frames": NUM_GIVEN, "clip_frames": CLIP_FRAMES, "psnr_ceiling_db": CEILING_DB},
        notes=(*(each.remark for each in clips), INTERVALS),
        provenance=_encoders(completers),
    )
    return scopes, content


def interpolation(scales: Sequence[Fraction], table: str, config: EvalConfig, store: Store) -> Content:
    """All rows of all data sets of the store, and which are not available.

    Raises `NoTakesError` if no data set has takes, and `UsageError` for an unknown encoder.
    """
    store.select(config.condition)  # raises at once for SQL that is wrong
    trained = trained_completers("interpolation", config.run, config.encoders, config.missing)
    completers = [*INTERPOLATION, *trained]
    scopes, content = _interpolated(store, data_sets_of(store, config.fps), scales, completers, config)
    labels = tuple(map(scale_label, scales))
    further = [find_metric(name) for name in ("rotation_angle_error", *TIMED_METRICS) if name not in METRICS]
    titles = {
        metric.name: metric.title[0].lower() + metric.title[1:] + (f" ({metric.unit})" if metric.unit else "")
        for metric in further
    }
    printed: dict[tuple[str, str], list[Reported]] = {}
    for figure in reported_figures("pahires", table):
        if figure.value is not None:
            printed.setdefault((figure.dataset, figure.metric), []).append(figure)
    printed_blocks = (
        printed_block(
            f"Printed in the PA-HiRes paper, {data_set}: {PRINTED_METRICS[metric]}",
            figures,
            lambda figure: "×" + figure.setting.removeprefix("x"),
            columns=labels,
            lower_is_better=False,
            note=f"Undefined pose vector, range and clips; trained for 1,000 epochs. Source: {SOURCES['pahires']}.",
        )
        for (data_set, metric), figures in printed.items()
    )
    blocks = blocks_of(scopes, completers, Shown(labels, METRICS, {"mpjpe_global": titles}))
    return replace(content, blocks=(*blocks, *printed_blocks))


# Trained runs by the entries' names, then by seed.
_Runs = Mapping[str, Mapping[int, RunFolder]]


def ablation_table(ablation: Ablation, config: EvalConfig, store: Store) -> Content:
    """Scores of the runs RUN-VARIANT on every data set, at their training framerate.

    Raises `UsageError` without a run's name, or if none of the runs is trained, and as `interpolation`.
    """
    store.select(config.condition)  # raises at once for SQL that is wrong
    runs = PAHIRES.trained_runs(ablation.table, config.run, STAGE)
    assert config.run is not None
    command = PAHIRES.command(ablation.table, config.run)
    config.missing.add(
        *(
            f"{entry.variant.name}: not trained ({command} --only {entry.variant.name})"
            for entry in ablation.entries
            if not runs[entry.name]
        )
    )
    folders = list(dict.fromkeys(run for by_seed in runs.values() for run in by_seed.values()))
    training = [recorded_settings(run, STAGE)["training"] for run in folders]
    rates = {Fraction(each["fps"]) for each in training}
    completers = [replace(completer_of(PAHIRES.paper, run.path), name=run.path.name) for run in folders]
    data_sets = [each for each in data_sets_of(store) if each.fps in rates]
    if not data_sets:
        named = ", ".join(f"{float(rate):g}" for rate in rates)
        raise NoTakesError(f"no data set stands at {named} fps, which the runs were trained for")
    scopes, content = _interpolated(store, data_sets, (ABLATED_SCALE,), [*UNTRAINED, *completers], config)
    steps = sorted({f"{each['schedule']['steps']:,} steps, form {each['answer']['form']}" for each in training})
    changes = {entry.name: list(entry.variant.change) for entry in ablation.entries}
    return replace(
        content,
        caption=f"One setting changes, after {' or '.join(steps)}, at {scale_label(ABLATED_SCALE)}. {content.caption}",
        blocks=(
            *(block for scope in scopes for block in _ablated(ablation, scope, runs)),
            *_starts(scopes, runs),
            *_printed_ablation(ablation.table),
        ),
        definition={**content.definition, "variants": changes},
        runs=tuple(run.path for run in folders),
        provenance={"runs": {run.path.name: run.stage(STAGE).read_summary() for run in folders}, **content.provenance},
    )


def _ablated(ablation: Ablation, scope: Scope, runs: _Runs) -> Iterable[Block]:
    columns = tuple(dict.fromkeys(entry.column for entry in ablation.entries))
    for metric in ABLATED_METRICS:
        cells: dict[str, dict[str, Cell]] = {entry.label: {} for entry in ablation.entries}
        for entry in ablation.entries:
            if values := _by_seed(scope, runs[entry.name], metric):
                cells[entry.label][entry.column] = Cell(fmean(values.values()))
        untrained = [(each.name, Cell(_number(scope, each.name, metric))) for each in UNTRAINED]
        rows = [
            # A row that does not depend on the setting has the same number in every column.
            *(Row(f"{name}, not trained", "reference", dict.fromkeys(columns, cell)) for name, cell in untrained),
            *(Row(row, "ours", found) for row, found in cells.items() if found),
        ]
        yield _block(f"{scope.label}: {METRICS[metric]}", metric, columns, rows, scope.note)


def _starts(scopes: Sequence[Scope], runs: _Runs) -> Iterable[Block]:
    """Runs that differ in their seed only, one by one."""
    several = {name: by_seed for name, by_seed in runs.items() if len(by_seed) > 1}
    seeds = tuple(f"seed {seed}" for seed in sorted({seed for by_seed in several.values() for seed in by_seed}))
    for metric in ABLATED_METRICS if several else ():
        rows = []
        for scope in scopes:
            for name, by_seed in several.items():
                found = _by_seed(scope, by_seed, metric)
                cells = {f"seed {seed}": Cell(value) for seed, value in found.items()}
                rows.append(Row(f"{scope.label}: {name}", "ours", cells))
        yield _block(f"From other starts: {METRICS[metric]}", metric, seeds, rows)


def _number(scope: Scope, row: str, metric: str) -> float:
    return scope.number(row, metric, scale_label(ABLATED_SCALE)).value


def _by_seed(scope: Scope, by_seed: Mapping[int, RunFolder], metric: str) -> dict[int, float]:
    names = {seed: run.path.name for seed, run in by_seed.items()}
    return {seed: _number(scope, name, metric) for seed, name in names.items() if name in scope.rows}


def _block(title: str, metric: str, columns: tuple[str, ...], rows: Sequence[Row], note: str = "") -> Block:
    lower = find_metric(metric).higher_is_better is False
    return Block(title, columns, tuple(rows), lower_is_better=lower, note=note, metrics=(shown_measure(metric),))


def _printed_ablation(table: str) -> list[Block]:
    """The paper's figures of an ablation; none of its figures 5 and 6, which it draws without numbers."""

    def setting(figure: Reported) -> dict[str, str]:
        return dict(part.partition("=")[::2] for part in figure.setting.split(";")[1:])

    figures = [figure for figure in reported_figures("pahires", table) if figure.value is not None]
    return [
        printed_block(
            f"Printed in the PA-HiRes paper: {PRINTED_METRICS[metric]}",
            [figure for figure in figures if figure.metric == metric],
            lambda figure: f"ζ = {setting(figure)['terms']}",
            name=lambda figure: "shared" if setting(figure)["shared"] == "yes" else "own parameters",
            lower_is_better=False,
            note=f"HumanML3D at ×4, 1,000 epochs. Source: {SOURCES['pahires']}.",
        )
        for metric in dict.fromkeys(figure.metric for figure in figures)
    ]


@dataclass(frozen=True)
class WindowTable:
    """A table over windows of 65 frames at 30 fps: its task, questions, metrics with titles, and untrained rows."""

    task: Task
    version: str
    questions: tuple[Question, ...]
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
    INBETWEENING_VERSION,
    gaps(),
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
    EXTRAPOLATION_VERSION,
    continuations(),
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

    Raises `NoTakesError` if the store has no windows, and `UsageError` for an unknown encoder.
    """
    store.select(config.condition)  # raises at once for SQL that is wrong
    trained = trained_completers(table.task, config.run, config.encoders, config.missing)
    completers = [*table.rows, *trained]

    def opened(data_set: DataSet) -> Clips:
        if data_set.value == "lafan1":
            windows = lafan1_windows(store)
        else:
            windows = data_set_windows(store, data_set, config.split, config.where)
        measure = partial(measure_windows, windows, table.questions)
        return Clips(windows.name, FPS, 0, f"{windows.name}: {windows.remark}", measure)

    terms = {"version": table.version, "store": store.fingerprint}
    data_sets = (each for each in data_sets_of(store) if each.fps == FPS)
    scopes, clips = _scored(table.task, data_sets, opened, terms, completers, config)
    columns = tuple(question.label for question in table.questions)
    return Content(
        caption=f"{table.caption} S{config.real[1:]}: {' '.join(each.remark for each in clips)}",
        blocks=(
            *blocks_of(scopes, completers, Shown(columns, table.metrics, table.details)),
            *(_printed_inbetweening(columns) if table is INBETWEENING else []),
        ),
        notes=(INTERVALS,),
        provenance=_encoders(completers),
    )


def _printed_inbetweening(columns: tuple[str, ...]) -> list[Block]:
    """Published figures for LaFAN1: the paper's, and those of the rows' own authors."""
    sources = {"pahires": "3", "lafan1": "benchmark", "delta-interp": "benchmark", "ts-former": "benchmark"}
    whose = {"pahires": "PA-HiRes paper", "lafan1": "benchmark"}
    figures = [figure for paper, table in sources.items() for figure in reported_figures(paper, table)]
    blocks = []
    for metric, title in WINDOW_METRICS.items():
        cells: dict[str, dict[str, Cell]] = {}
        for figure in figures:
            if figure.value is not None and figure.metric.removesuffix("_percent") == metric:
                value = round(figure.value / 100, 6) if figure.metric.endswith("_percent") else figure.value
                name = f"{figure.method} ({whose.get(figure.paper, 'its authors')})"
                cells.setdefault(name, {})[figure.setting] = Cell(value)
        rows = tuple(Row(name, "paper", found) for name, found in cells.items())
        note = f"Sources: {'; '.join(SOURCES[paper] for paper in sources)}." if metric == "npss" else ""
        blocks.append(Block(f"Printed for LaFAN1: {title}", columns, rows, note=note))
    return blocks


def _interpolation_table(number: str, kind: str, scales: Sequence[Fraction]) -> Table:
    return Table(
        "pahires",
        number,
        f"interpolation at {kind} scales",
        VERSION,
        partial(interpolation, scales, number),
        heading=f"PA-HiRes, Table {number}: interpolation at {kind} scales",
        shown=partial(installed_encoders, "interpolation"),
    )


def _ablation_table(number: str) -> Table:
    ablation = PAHIRES.tables[number]
    table = Table("pahires", number, ablation.title, VERSION, partial(ablation_table, ablation))
    return replace(table, heading=f"PA-HiRes, {table.place}: {ablation.title}")


def _window_table(number: str, title: str, heading: str, table: WindowTable) -> Table:
    return Table(
        "pahires",
        number,
        title,
        table.version,
        partial(window_table, table),
        heading=f"PA-HiRes{heading}",
        shown=partial(installed_encoders, table.task),
        task="pahires-extrapolation" if table is EXTRAPOLATION else "",
    )


TABLE_1 = _interpolation_table("1", "integer", INTEGER_SCALES)
TABLE_2 = _interpolation_table("2", "non-integer", OTHER_SCALES)
TABLE_3 = _window_table("3", "in-betweening (LaFAN1's protocol)", ", Table 3: in-betweening", INBETWEENING)
TABLE_4, FIGURE_5, FIGURE_6 = map(_ablation_table, ("4", "figure5", "figure6"))
TABLE_EXTRAPOLATION = _window_table(
    "extrapolation", "extrapolation, forwards and backwards", ": extrapolation", EXTRAPOLATION
)
