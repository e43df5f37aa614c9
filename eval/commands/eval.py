"""`motionkit eval`: build a table or a figure, or calibrate the feature sets."""

import shlex
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from eval.commands.eval_options import (
    ALL,
    ClipOptions,
    EvaluatedOptions,
    EvaluatorOptions,
    OutputOptions,
    ProtocolOptions,
    RealOptions,
    TableOptions,
    in_groups,
)
from motionkit.cli.console import print_json, print_text, progress, stderr, stdout
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import default_path, write_whole

if TYPE_CHECKING:
    from eval.report.results import Result
    from eval.tables.registry import Table, TableRequest

SHOWN_PROBLEMS = 10


@in_groups
def evaluate(
    wanted: TableOptions,
    real: RealOptions,
    evaluated: EvaluatedOptions,
    output: OutputOptions,
    clips: ClipOptions,
    evaluator: EvaluatorOptions,
    protocol: ProtocolOptions,
) -> None:
    """Build one of the papers' tables or figures, or calibrate the features that clip-FID is computed on.

    Example: motionkit eval --table 2
    """
    from eval.tables.registry import TableRequest, find_table

    tables = {number: None if number is None else find_table(wanted.paper, number) for number in wanted.numbers}
    if wanted.calibrate and (clips.low_pass is not None or evaluated.samples):
        raise UsageError("--calibrate damages real motion by itself: leave out --low-pass and --samples")
    request = TableRequest(
        real=real.chosen(),
        results=output.results or default_path("results"),
        evaluated=evaluated.chosen(),
        evaluators=evaluator.chosen(),
        clip_fid=clips.chosen(output.seed),
        published=protocol.chosen(),
        fps=clips.framerates(),
        seed=output.seed,
    )
    with progress() as show:
        request = replace(request, on_progress=show)
        if any(table is not None and table.takes_samples for table in tables.values()):
            _print_left_out(request)
        if wanted.table == ALL:
            _build_all(request, tables, output.as_json)
        else:
            result = _build(request, *tables.values())
            _show(result, output.as_json)
            _refuse_rowless(request, result)
    if not evaluated.allow_broken:
        _refuse_broken(request)


def _build_all(request: "TableRequest", tables: "Mapping[str | None, Table | None]", as_json: bool) -> None:
    """Build every table in turn; raises `UsageError` at the end, with reasons, if some could not be built."""
    from dataclasses import asdict

    results, lacking = [], []
    for number, table in tables.items():
        try:
            result = _build(request, table)
            results.append(result)
            _refuse_rowless(request, result)
        except MotionkitError as error:
            lacking.append(f"{number}: {error}")
            continue
        if not as_json:
            _show(result)
    if as_json:
        print_json([asdict(result) for result in results])
    if lacking:
        raise UsageError(f"{len(results)} of {len(tables)} were built. " + "; ".join(lacking))


def _refuse_rowless(request: "TableRequest", result: "Result") -> None:
    """Raise if samples have no row in the table, with the reason."""
    from eval.sample_folder import SampleFolderError
    from eval.tables.nerm.copies import TITLE as COPIES
    from motionkit.generate.models import installed_models

    scored = [block for block in result.blocks if block.title != COPIES]
    shown = {row.name for block in scored for row in block.rows if row.cells}
    rowless = [name for name in request.evaluated.samples if name not in shown]
    systems = {*(loader.title for loader in installed_models().values()), *request.evaluated.samples}
    for name in rowless:
        # The lines of "MDM, 50 steps" are not those of "MDM".
        others = tuple(each for each in systems if each != name and each.startswith(name))
        own = (f"{name}:", f"{name},")
        reasons = [line for line in result.missing if line.startswith(own) and not line.startswith(others)]
        stderr.print(f"no row for {reasons[0] if reasons else name}")
    if rowless:
        raise SampleFolderError(f"the table was written without rows for {', '.join(map(repr, rowless))}")


def _print_left_out(request: "TableRequest") -> None:
    """Read the samples, and name those that are left out."""
    for folder in request.sample_folders:
        for problem in folder.left_out[:SHOWN_PROBLEMS]:
            stderr.print(f"left out of {folder.name!r}: {problem}")
        if len(folder.left_out) > SHOWN_PROBLEMS:
            stderr.print(f"… and {len(folder.left_out) - SHOWN_PROBLEMS:,} more: motionkit samples FOLDER")


def _refuse_broken(request: "TableRequest") -> None:
    """Raise if samples were left out."""
    from eval.sample_folder import SampleFolderError

    left_out = {folder.name: len(folder.left_out) for folder in request.sample_folders if folder.left_out}
    if left_out:
        counts = ", ".join(f"{count:,} of {name!r}" for name, count in left_out.items())
        raise SampleFolderError(f"the table was built without broken samples ({counts}); --allow-broken accepts that")


def _say_what_is_lacking(table: "Table", request: "TableRequest") -> None:
    """Print the command that trains all systems without a row, if any."""
    run = request.evaluated.run
    lacking = [each.title for each in table.shown().values() if run is None or not each.complete_in(run)]
    if lacking:
        number = table.number.removeprefix("figure")
        target = f"{'table' if number == table.number else 'figure'}:{number}"
        paper = "" if table.is_default else f" --paper {table.paper}"
        named = "" if run is None or run.name == "nano" else f" --run {shlex.quote(run.name)}"
        command = f"motionkit train --for {target}{paper}{named}"
        stderr.print(f"no rows of {', '.join(lacking)}: {command} trains the missing ones")


def _build(request: "TableRequest", table: "Table | None") -> "Result":
    """Build and write a table (None: the calibration)."""
    from eval.report.render import to_markdown
    from eval.report.results import write_result
    from eval.tables.calibration import build_calibration

    if table is None:
        result = build_calibration(request)
    else:
        if request.evaluated.samples and not table.takes_samples:
            raise UsageError(f"{table.title!r} has no rows of samples: leave out --samples")
        result = table.build(request)
        _say_what_is_lacking(table, request)
    path = write_result(result, request.results)
    if result.figure:
        from eval.report.curves import calibration_figure
        from eval.report.figures import save

        save(calibration_figure(result), request.results / result.figure)
    write_whole(path.with_suffix(".md"), to_markdown(result))
    beside = " and ".join(filter(None, (path.with_suffix(".md").name, result.figure)))
    stderr.print(f"written: {path}, beside it {beside}")
    return result


def _show(result: "Result", as_json: bool = False) -> None:
    """Print a result: as JSON, as tables of the terminal's width, or as Markdown."""
    from dataclasses import asdict

    from eval.report.render import to_markdown

    if as_json:
        print_json(asdict(result))
    elif stdout.is_terminal:
        _print_tables(result)
    else:
        print_text(to_markdown(result))


def _print_tables(result: "Result") -> None:
    """The numbers of a result for a terminal; notes and further metrics are in the file."""
    from eval.report.render import format_cell
    from motionkit.cli.console import print_table

    stdout.print(result.title)
    for line in (result.caption, *result.missing):
        stdout.print(line, soft_wrap=False)
    for block in result.blocks:
        stdout.print("")
        stdout.print(block.title)
        rows = [
            (row.name, [format_cell(row.cells.get(column), row.origin == "paper") for column in block.columns])
            for row in block.rows
        ]
        print_table(block.columns, rows)
