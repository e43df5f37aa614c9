"""PA-HiRes' tables over windows of 65 frames at 30 fps: in-betweening by LaFAN1's benchmark (3), and extrapolation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from eval.completion.data_sets import NoTakesError, data_sets_of, shared_reason
from eval.completion.encoders import HOLD, INTERPOLATION, Completer, trained_completers
from eval.completion.scores import Scope, Scores, Shown, blocks_of, with_pools
from eval.completion.windows import (
    EXTRAPOLATION_VERSION,
    FPS,
    INBETWEENING_VERSION,
    PoseWindows,
    Question,
    continuations,
    data_set_windows,
    gaps,
    lafan1_windows,
    measure_windows,
)
from eval.config import EvalConfig
from eval.report.results import Block, Cell, Row
from eval.tables.table import SOURCES, Content, Reported, Table, cached, reported_figures
from motionkit.core.errors import MotionkitError
from motionkit.core.progress import task
from motionkit.edit.encoders import installed_encoders
from motionkit.store.reader import Store
from motionkit.training.run import Task

SLERP = next(row for row in INTERPOLATION if row.name == "SLERP")
_OTHERS = {
    "hold": ("zero velocity", "the last given pose"),
    "SLERP": ("interpolation (SLERP)", "the benchmark's own interpolation: local great arcs, root on a line"),
}
METRICS = {"l2p": "L2P", "l2q": "L2Q", "npss": "NPSS"}
INTERVAL_NOTE = "± is half the 95 % interval over takes: all windows of a take are resampled together."
# Limitations of printed rows.
CAVEATS = {
    "MC-Trans": "its L2Q equals ERD-QV's digit for digit; its authors' own L2Q at 30 frames is 0.61",
    "NeMF": "its authors never published figures on LaFAN1",
}
WHOSE = {"pahires": "PA-HiRes paper", "lafan1": "benchmark"}


@dataclass(frozen=True)
class WindowTable:
    """A table's task, questions, blocks by metric with their titles (and further metrics of a block), and rows.

    `printed` says whether published figures follow.
    """

    task: Task
    version: str
    questions: tuple[Question, ...]
    metrics: Mapping[str, str]
    details: Mapping[str, Mapping[str, str]]
    rows: tuple[Completer, ...]
    caption: str
    notes: tuple[str, ...]
    printed: bool = False


INBETWEENING = WindowTable(
    "inbetweening",
    INBETWEENING_VERSION,
    gaps(),
    METRICS,
    {"l2p": {"mpjpe_global": "MPJPE (cm)"}, "l2q": {"l2q_as_signed": "L2Q, signs as they come"}},
    tuple(
        replace(row, name=name, note=note)
        for row in INTERPOLATION
        for name, note in [_OTHERS.get(row.name, (row.name, row.note))]
    ),
    caption=(
        "10 past frames and the first future one are given, the n frames between them asked for and scored "
        "(LaFAN1's protocol, 30 fps)."
    ),
    notes=(
        INTERVAL_NOTE,
        "Figures of one data set do not compare with another's: they are divided by its own deviations.",
        "The benchmark's own figures of zero velocity and interpolation have signs of quaternions as they come; "
        "that L2Q stands under further metrics.",
    ),
    printed=True,
)
EXTRAPOLATION = WindowTable(
    "extrapolation",
    EXTRAPOLATION_VERSION,
    continuations(),
    {"mpjpe_global": "MPJPE (cm)", **METRICS},
    {},
    (
        replace(HOLD, name="zero velocity", note="the nearest given pose"),
        replace(
            SLERP,
            name="constant velocity",
            note="joints go on turning as between the last two given poses, the root moving",
        ),
    ),
    caption=(
        "30 frames (one second) are given, the n frames after or before them asked for and scored; windows and "
        "statistics of the in-betweening table."
    ),
    notes=(
        INTERVAL_NOTE,
        "The paper shows extrapolation in pictures alone and prints no figures.",
        "What people do next is not in what they did: an error that grows slowly says that a row does not drift, "
        "not that it foresees.",
    ),
)


def compute(table: WindowTable, config: EvalConfig, store: Store) -> Content:
    """Every row of every data set at 30 fps; `--fps` is ignored.

    Raises `NoTakesError` if the store has no windows, and `UsageError` for an unknown encoder.
    """
    store.select(config.condition)  # raises at once for SQL that is wrong
    trained = trained_completers(table.task, config.run, config.encoders, config.missing)
    completers = [*table.rows, *trained]
    every = _all_windows(store, config)
    scopes = [Scope(windows.name, FPS, _rows(table, windows, completers, store, config)) for windows in every]
    columns = tuple(question.label for question in table.questions)
    shown = Shown(columns, table.metrics, table.details)
    remarks = " ".join(f"{windows.name}: {windows.remark}" for windows in every)
    return Content(
        caption=f"{table.caption} S{config.real[1:]}: {remarks}",
        blocks=(
            *blocks_of(with_pools(scopes, "windows"), completers, shown),
            *(_published(columns) if table.printed else []),
        ),
        notes=table.notes,
        provenance={
            "encoders": {completer.name: completer.fingerprint for completer in completers},
            "trained": {completer.name: completer.facts for completer in trained},
        },
    )


def _all_windows(store: Store, config: EvalConfig) -> list[PoseWindows]:
    """The windows of all data sets at 30 fps that have any."""
    found, without = [], []
    for data_set in (each for each in data_sets_of(store) if each.fps == FPS):
        with task(config.on_progress, f"windows of {data_set.name}"):
            try:
                if data_set.value == "lafan1":
                    found.append(lafan1_windows(store))
                else:
                    found.append(data_set_windows(store, data_set, config.split, config.where))
            except NoTakesError as error:
                without.append(f"{data_set.label}: {error}")
    if not found:
        raise NoTakesError(shared_reason(without))
    config.missing.add(*without)
    return found


def _rows(
    table: WindowTable, windows: PoseWindows, completers: Sequence[Completer], store: Store, config: EvalConfig
) -> dict[str, Scores]:
    terms = {
        "version": table.version,
        "store": store.fingerprint,
        "windows": windows.name,
        "split": config.split,
        "where": config.where,
    }
    rows: dict[str, Scores] = {}

    with task(config.on_progress, windows.name, len(completers)) as work:
        for completer in completers:
            work.note(completer.name)
            with config.missing.skipping(f"{windows.name}, {completer.name}", (MotionkitError, ValueError)):
                rows[completer.name] = cached(
                    config.results,
                    table.task,
                    {**terms, "encoder": completer.fingerprint},
                    partial(measure_windows, windows, table.questions, completer),
                )
            work.advance()
    return rows


def _published(columns: tuple[str, ...]) -> list[Block]:
    """Published figures for LaFAN1: the paper's, and those of the rows' own authors."""
    others = ("lafan1", "delta-interp", "ts-former")
    figures = [*reported_figures("pahires", "3"), *(each for paper in others for each in _benchmark(paper))]
    blocks = []
    for metric, title in METRICS.items():
        cells: dict[str, dict[str, Cell]] = {}
        for figure in figures:
            if figure.value is not None and figure.metric.removesuffix("_percent") == metric:
                percent = figure.metric.endswith("_percent")
                value = round(figure.value / 100, 6) if percent else figure.value
                name = f"{figure.method} ({WHOSE.get(figure.paper, 'its authors')})"
                cells.setdefault(name, {})[figure.setting] = Cell(value)
        rows = tuple(
            Row(name, "paper", found, CAVEATS.get(name.partition(" (")[0], "")) for name, found in cells.items()
        )
        note = ""
        if metric == "npss":
            sources = "; ".join(SOURCES[paper] for paper in ("pahires", *others))
            note = f"The PA-HiRes paper prints NPSS in percent; it stands here as it is elsewhere. Sources: {sources}."
        blocks.append(Block(f"Printed for LaFAN1: {title}", columns, rows, note=note))
    return blocks


def _benchmark(paper: str) -> list[Reported]:
    return reported_figures(paper, "benchmark")


TABLE_3 = Table(
    "pahires",
    "3",
    "in-betweening (LaFAN1's protocol)",
    INBETWEENING_VERSION,
    partial(compute, INBETWEENING),
    heading="PA-HiRes, Table 3: in-betweening",
    shown=partial(installed_encoders, "inbetweening"),
)
TABLE_EXTRAPOLATION = Table(
    "pahires",
    "extrapolation",
    "extrapolation, forwards and backwards",
    EXTRAPOLATION_VERSION,
    partial(compute, EXTRAPOLATION),
    heading="PA-HiRes: extrapolation",
    shown=partial(installed_encoders, "extrapolation"),
    task="pahires-extrapolation",
)
