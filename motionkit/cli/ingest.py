"""`motionkit ingest`: sources into a store."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motionkit.cli import ingest_options as option
from motionkit.cli.ingest_options import Compat, OnError
from motionkit.cli.reading import read_options
from motionkit.console import print_json, print_text, progress, stderr, stdout
from motionkit.core.progress import Task, task
from motionkit.errors import FormatError, MotionkitError, UsageError
from motionkit.plain_text import printable
from motionkit.settings import default_path, optional_path

if TYPE_CHECKING:
    from motionkit.formats.items import IndexOptions
    from motionkit.store.ingest import DatasetCount, IngestReport

# Of the files that were ignored.
SHOWN_KINDS = 5


def ingest(
    sources: option.Sources,
    store: option.StorePath = None,
    format: option.FormatName = "auto",
    captions: option.CaptionsTable = None,
    index: option.Indexes = None,
    texts: option.TextsFolder = None,
    splits: option.SplitsFolder = None,
    mirrored: option.Mirrored = False,
    compat: option.Published = None,
    fps: option.GivenFps = None,
    fps_rules: option.FpsRules = None,
    unit_metres: option.UnitMetres = None,
    skeleton_map: option.SkeletonMaps = None,
    body_models: option.BodyModels = None,
    on_error: option.OnErrorChoice = OnError.SKIP,
    overwrite: option.Overwrite = False,
    workers: option.Workers = None,
    engine: option.EngineName = "local",
    as_json: option.AsJson = False,
) -> None:
    """Read motions of any known format into a store, at their native framerates.

    A store that exists is added to: sequences that it holds from equal files are left alone, and the same id from
    another file is refused. The store is the same whatever the engine and the number of workers.
    """
    from motionkit.workers.engines import LOCAL
    from motionkit.workers.process_engine import start_server

    if engine == LOCAL and workers is not None and workers > 1:
        start_server()

    from motionkit.formats.framerate_rules import read_rules
    from motionkit.skeletons.families import read_skeleton_map
    from motionkit.store.ingest import Listener
    from motionkit.store.ingest import ingest as ingest_sources

    options = read_options(format, fps, unit_metres, captions)
    options = replace(
        options,
        index=_index_options(index, texts, splits, mirrored, compat, captions),
        skeleton_maps=tuple(read_skeleton_map(path) for path in skeleton_map or ()),
        fps_rules=tuple(rule for path in fps_rules or () for rule in read_rules(path)),
        body_models=_body_models(body_models),
    )
    teller = _Teller()
    with progress() as show, task(show, "ingest", note="scanning") as work:
        report = ingest_sources(
            sources,
            store or default_path("store"),
            options=options,
            on_error=on_error.value,
            overwrite=overwrite,
            num_workers=workers,
            engine=engine,
            listener=Listener(
                on_start=partial(_start, work),
                on_item=work.advance,
                on_warning=lambda warning: teller.tell(warning, "warning: "),
                on_problem=teller.tell,
            ),
        )
    if as_json:
        print_json(_as_json(report))
    else:
        _print_summary(report)
    _check_success(report, on_error)


def _start(work: Task, num_items: int) -> None:
    work.note("")
    work.set_total(num_items)


def _check_success(report: "IngestReport", on_error: OnError) -> None:
    if report.problems and on_error is OnError.STOP:
        raise MotionkitError(f"stopped at the first problem; the store {report.store} is as it was")
    if not report.num_in_store:
        raise MotionkitError(f"nothing could be stored in {report.store}")
    if report.problems and not report.num_stored:
        raise MotionkitError(f"nothing was stored; the store {report.store} is as it was")


def _body_models(given: Path | None) -> Path | None:
    folder = given or optional_path("body_models")
    if folder is not None and not folder.is_dir():
        raise UsageError(f"--body-models {folder}: no such folder")
    return None if folder is None else folder.resolve()


def _index_options(
    index: list[Path] | None,
    texts: Path | None,
    splits: Path | None,
    mirrored: bool,
    compat: Compat | None,
    captions: Path | None,
) -> "IndexOptions | None":
    from motionkit.formats.items import IndexOptions

    if not index:
        given = {"--texts": texts, "--splits": splits, "--mirrored": mirrored, "--compat": compat}
        if any(given.values()):
            name = next(name for name, value in given.items() if value)
            raise UsageError(f"{name} is about an index: give one with --index")
        return None
    if captions is not None:
        raise UsageError("--captions describes whole files; the captions of an index are its own or those of --texts")
    return IndexOptions(tuple(index), texts, splits, mirrored, published=compat is not None)


class _Teller:
    """Prints problems and warnings as they come, of each reason the first few: a corpus can have thousands."""

    NUM_SHOWN = 5

    def __init__(self) -> None:
        self._num_told: Counter[str] = Counter()

    def tell(self, problem: FormatError, kind: str = "") -> None:
        """Print one problem behind its `kind`, or where the others of its reason are to be found."""
        self._num_told[problem.reason] += 1
        if self._num_told[problem.reason] <= self.NUM_SHOWN:
            stderr.print(f"{kind}{problem}")
        elif self._num_told[problem.reason] == self.NUM_SHOWN + 1:
            stderr.print(
                f"{kind}more of the kind {problem.reason}: counted at the end, --json names them all", markup=False
            )


def _print_summary(report: "IngestReport") -> None:
    hours = report.duration_seconds / 3600
    stdout.print(
        f"stored {_counted(report.num_stored, 'sequence')} ({hours:.2f} h, {_counted(report.num_frames, 'frame')}) "
        f"in {report.store}, "
        f"which holds {report.num_in_store:,}",
        markup=False,
    )
    if report.num_already_stored:
        stdout.print(f"already there: {report.num_already_stored:,}")
    for name, counts in (("failed", report.problems_by_reason), ("warnings", report.warnings_by_reason)):
        if counts:
            reasons = ", ".join(f"{count:,} {reason}" for reason, count in counts.items())
            stdout.print(f"{name}: {sum(counts.values()):,} ({reasons})", markup=False)
    if report.ignored:
        stdout.print(_ignored_line(report))
    if report.datasets:
        print_text(_dataset_table(report.datasets))


def _ignored_line(report: "IngestReport") -> str:
    kinds = list(report.ignored_by_suffix.items())
    shown = ", ".join(f"{count:,} {kind}" for kind, count in kinds[:SHOWN_KINDS])
    more = ", …" if len(kinds) > SHOWN_KINDS else ""
    line = f"ignored: {len(report.ignored):,} ({shown}{more}; the first: {report.ignored[0]})"
    has_arrays = any(path.suffix.lower() in (".npy", ".npz") for path in report.ignored)
    return f"{line}; ingest an array alone to be told what it holds" if has_arrays else line


def _counted(number: int, noun: str) -> str:
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def _dataset_table(counts: "Sequence[DatasetCount]") -> str:
    rows = [(printable(each.dataset) or "-", each.num_found, each.num_missing, each.num_failed) for each in counts]
    rows.append(("all", sum(row[1] for row in rows), sum(row[2] for row in rows), sum(row[3] for row in rows)))
    width = max(len("dataset"), *(len(row[0]) for row in rows))
    lines = [f"{name:{width}} {found:7,} {missing:8,} {failed:7,}" for name, found, missing, failed in rows]
    return "\n".join((f"{'dataset':{width}}   found  missing  failed", *lines))


def _as_json(report: "IngestReport") -> dict[str, Any]:
    return {
        "store": str(report.store),
        "committed": report.committed,
        "stored": report.num_stored,
        "frames": report.num_frames,
        "hours": report.duration_seconds / 3600,
        "already_stored": report.num_already_stored,
        "sequences_in_store": report.num_in_store,
        "failed": report.problems_by_reason,
        "warnings": report.warnings_by_reason,
        "datasets": {
            count.dataset: {"found": count.num_found, "missing": count.num_missing, "failed": count.num_failed}
            for count in report.datasets
        },
        "ignored": report.ignored_by_suffix,
        "ignored_paths": [str(path) for path in report.ignored],
        "problems": _named(report.problems),
        "warned": _named(report.warnings),
    }


def _named(problems: Sequence[FormatError]) -> list[dict[str, str]]:
    return [{"reason": problem.reason, "message": str(problem)} for problem in problems]
