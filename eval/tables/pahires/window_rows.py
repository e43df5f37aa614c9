"""Tables over windows of poses: all their rows on all data sets at 30 fps, measured once and cached."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eval.completion.blocks import Scope, Shown, blocks_of, with_pools
from eval.completion.encoders import Completer, trained_completers
from eval.completion.inbetweening import METRICS, measure_windows, num_batches
from eval.completion.protocol import Question
from eval.completion.scores import Scores
from eval.completion.takes import DataSet, NoTakesError, data_sets_of, shared_reason
from eval.completion.windows import FPS, PoseWindows, data_set_windows, lafan1_windows, num_lafan1_takes
from eval.report.results import Block
from eval.sets.partial import PartialResult, collect
from eval.tables.pahires.measured import find_scores, keep_scores
from eval.tables.registry import TableRequest
from motionkit.core.errors import MotionkitError
from motionkit.core.progress import task
from motionkit.training.run import Task

if TYPE_CHECKING:
    from motionkit.store.reader import Store


@dataclass(frozen=True)
class WindowTable:
    """A table's task, blocks and rows.

    `metrics` are blocks by metric, with their titles; `details` further metrics of a block, likewise. The run's
    encoders of the `task` are used.
    """

    name: str
    version: str
    questions: tuple[Question, ...]
    metrics: Mapping[str, str]
    details: Mapping[str, Mapping[str, str]]
    rows: tuple[Completer, ...]
    task: Task


@dataclass(frozen=True, eq=False)
class WindowBlocks:
    """All blocks of a table, remarks on each data set, and what is not available."""

    blocks: tuple[Block, ...]
    remarks: tuple[str, ...]
    missing: tuple[str, ...]
    provenance: Mapping[str, Any]


def measure_table(table: WindowTable, request: TableRequest) -> WindowBlocks:
    """Every row of every data set at 30 fps; `--fps` is ignored.

    Raises `NoTakesError` if the store has no windows, `UsageError` for an unknown encoder, and as opening the store.
    """
    store = request.open_store()
    store.select(request.real.condition)  # raises at once for SQL that is wrong
    trained = trained_completers(table.task, request.evaluated.run, request.evaluated.encoders)
    completers = [*table.rows, *trained.value]
    found = _all_windows(store, request)
    if not found.value:
        raise NoTakesError(shared_reason(found.missing))
    rows = [_rows(table, windows, completers, store.fingerprint, request) for windows in found.value]
    scopes = [Scope(windows.name, FPS, each.value) for windows, each in zip(found.value, rows, strict=True)]
    failed = [line for each in rows for line in each.missing]
    shown = Shown(tuple(question.label for question in table.questions), table.metrics, table.details)
    return WindowBlocks(
        tuple(blocks_of(with_pools(scopes, "windows"), completers, shown)),
        tuple(f"{windows.name}: {windows.remark}" for windows in found.value),
        tuple(dict.fromkeys((*trained.missing, *failed, *found.missing))),
        request.provenance(
            store,
            encoders={completer.name: completer.fingerprint for completer in completers},
            trained={completer.name: completer.facts for completer in completers if completer.trained},
        ),
    )


def _all_windows(store: "Store", request: TableRequest) -> PartialResult[list[PoseWindows]]:
    """The windows of all data sets at 30 fps that have any."""

    def windows(data_set: DataSet) -> PoseWindows:
        with task(request.on_progress, f"windows of {data_set.name}") as work:
            if data_set.value != "lafan1":
                return data_set_windows(store, data_set, request.real.split, request.real.where)
            work.set_total(num_lafan1_takes(store))
            return lafan1_windows(store, work.advance)

    at_30 = [data_set for data_set in data_sets_of(store) if data_set.fps == FPS]
    found = collect(at_30, windows, lambda data_set: data_set.label, (NoTakesError,))
    return PartialResult(list(found.value.values()), found.missing)


def _rows(
    table: WindowTable,
    windows: PoseWindows,
    completers: Sequence[Completer],
    fingerprint: str,
    request: TableRequest,
) -> PartialResult[dict[str, Scores]]:
    terms = {
        "version": table.version,
        "store": fingerprint,
        "windows": windows.name,
        "split": request.real.split,
        "where": request.real.where,
    }
    columns = [question.label for question in table.questions]
    rows: dict[str, Scores] = {}
    missing: list[str] = []
    with task(request.on_progress, windows.name, num_batches(windows) * len(completers)) as work:
        for completer in completers:
            work.note(completer.name)
            of_row = {**terms, "encoder": completer.fingerprint}
            scores = find_scores(request.results, table.name, of_row, METRICS, columns)
            if scores is None:
                try:
                    scores = measure_windows(windows, table.questions, completer, work.advance)
                except (MotionkitError, ValueError) as error:
                    missing.append(f"{windows.name}, {completer.name}: {error}")
                    continue
                keep_scores(request.results, table.name, of_row, scores)
            rows[completer.name] = scores
    return PartialResult(rows, tuple(missing))
