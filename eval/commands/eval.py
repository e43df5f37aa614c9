"""`motionkit eval`: build a table or a figure, or calibrate the feature sets."""

import shlex
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.cli.console import print_json, print_text, progress, stderr, stdout
from motionkit.core import plugins
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import default_path, write_whole

if TYPE_CHECKING:
    from fractions import Fraction

    from eval.report.results import Result
    from eval.tables.table import EvalConfig, Table

ALL = "all"
SHOWN_PROBLEMS = 10


def _option(panel: str, help: str, *names: str, **more: Any) -> Any:
    return typer.Option(*names, help=help, rich_help_panel=panel, **more)


REAL, EVALUATED, EVALUATOR = "Real motion", "What is evaluated", "Evaluator"
CLIPS = "clip-FID (table 2, figures, --calibrate)"
PROTOCOL = "Protocol of whole motions (tables 1 and 3)"


def evaluate(
    table: Annotated[
        str | None, typer.Option(help="Table to build, by its number in the paper; all: every table and figure.")
    ] = None,
    figure: Annotated[str | None, typer.Option(help="Figure to build as a table, by its number: 5, 8.")] = None,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="Check that clip-FID rises with damage, and only with damage.")
    ] = False,
    paper: Annotated[str, typer.Option(help="Paper whose table is meant.")] = "nerm",
    results: Annotated[Path | None, typer.Option(help="Folder for the JSON result and its Markdown table.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    store: Annotated[Path | None, _option(REAL, "Store with the real motion.")] = None,
    split: Annotated[str, _option(REAL, "Real sequences to compare with: a split, or all.")] = "test",
    where: Annotated[
        str | None,
        _option(
            REAL,
            'Compare only with real sequences for which this holds too: "len(quality_flags) = 0".',
            metavar="SQL",
        ),
    ] = None,
    runs: Annotated[Path | None, _option(EVALUATED, "Folder of all runs.")] = None,
    run: Annotated[
        str, _option(EVALUATED, "Trained run to evaluate; its rows are left out where there is none.")
    ] = "nano",
    samples: Annotated[
        list[str] | None,
        _option(EVALUATED, "A folder of another system's motions, as a row (docs/samples.md).", metavar="NAME=DIR"),
    ] = None,
    samples_fps: Annotated[
        str | None, _option(EVALUATED, "Framerate of samples whose files do not say it.", metavar="FPS")
    ] = None,
    allow_broken: Annotated[
        bool,
        _option(
            EVALUATED,
            "Exit with 0 even if samples that are unreadable, hold NaN or are no bodies were left out.",
            "--allow-broken",
        ),
    ] = False,
    encoder: Annotated[
        list[str] | None,
        _option(
            EVALUATED,
            "Of completed motion: another run's trained encoder, as a row: liif=wide.",
            metavar="NAME=RUN",
        ),
    ] = None,
    motions: Annotated[int, _option(EVALUATED, "Maximum number of motions that a model generates.", min=2)] = 1024,
    draws: Annotated[
        int, _option(EVALUATED, "How often a model generates the whole set; published protocols: 20.", min=1)
    ] = 1,
    fps: Annotated[str | None, _option(CLIPS, "Framerates, such as 20,60,120; the table's own by default.")] = None,
    clips: Annotated[int, _option(CLIPS, "Clips on each side (N).", min=64)] = 4096,
    replications: Annotated[int, _option(CLIPS, "Independent repetitions behind the intervals.", min=1)] = 20,
    sizes: Annotated[str, _option(CLIPS, "Clip sizes in poses.")] = "16:64",
    evaluator: Annotated[
        str | None,
        _option(
            EVALUATOR,
            "Feature sets: kinematic,native,guo,motion-clip,tmr; all there are. Of actions: linear, humanact12, …",
            "--evaluator",
            "--features",
        ),
    ] = None,
    weights: Annotated[
        Path | None,
        _option(EVALUATOR, "The published evaluator's or recogniser's file: finest.tar, ….tar.", metavar="FILE"),
    ] = None,
    glove: Annotated[
        Path | None, _option(EVALUATOR, "Its word vectors: our_vab_data.npy, _words.pkl, _idx.pkl.", metavar="DIR")
    ] = None,
    statistics: Annotated[
        Path | None,
        _option(EVALUATOR, "Its mean.npy and std.npy; those beside the weights by default.", metavar="DIR"),
    ] = None,
    motion_clip: Annotated[
        Path | None,
        _option(EVALUATOR, "MARDM's MotionCLIP: finest.tar, its statistics, CLIP's words.", metavar="DIR"),
    ] = None,
    protocol: Annotated[
        str,
        _option(
            PROTOCOL, "Of texts: native, nerm, t2m, mdm, mld, t2m-gpt, momask, mardm, tmr, kimodo; of actions: a2m, …"
        ),
    ] = "native",
) -> None:
    """Build one of the papers' tables or figures, or calibrate the features that clip-FID is computed on.

    Example: motionkit eval --table 2
    """
    from eval.clip_fid.score import Protocol
    from eval.sample_folder import SampleOptions
    from eval.tables.table import EvalConfig
    from eval.text_motion.guo.kind import GuoFiles

    tables = _chosen(table, figure, calibrate, paper)
    if calibrate and samples:
        raise UsageError("--calibrate damages real motion by itself: leave out --samples")
    if weights is None and (glove or statistics):
        option = "--glove" if glove else "--statistics"
        raise UsageError(f"{option} needs a published evaluator: give its weights with --weights finest.tar")
    folder = runs or default_path("runs")
    config = EvalConfig(
        store=store or default_path("store"),
        results=results or default_path("results"),
        split=split,
        where=where,
        run=folder / run,
        samples=named_samples(samples or [], folder / run),
        sample_options=SampleOptions(framerates(samples_fps, "--samples-fps")[0] if samples_fps else None),
        encoders=tuple(_encoder(pair, folder) for pair in encoder or []),
        max_motions=motions,
        draws=draws,
        evaluators=tuple(evaluator.split(",")) if evaluator else None,
        guo=None if weights is None else GuoFiles(weights, glove, statistics),
        motion_clip=motion_clip,
        clips=Protocol(*_sizes(sizes), num_clips=clips, replications=replications, seed=seed),
        protocol=protocol,
        fps=framerates(fps, "--fps") if fps else None,
        seed=seed,
    )
    with progress() as show:
        config = replace(config, on_progress=show)
        if any(each.takes_samples for each in tables.values()):
            _print_left_out(config)
        if table == ALL:
            _build_all(config, tables, as_json)
        else:
            (chosen,) = tables.values()
            result = _build(config, chosen)
            _show(result, as_json)
            _refuse_rowless(config, result)
    left_out = {folder.name: len(folder.left_out) for folder in config.sample_folders if folder.left_out}
    if left_out and not allow_broken:
        from eval.sample_folder import SampleFolderError

        counts = ", ".join(f"{count:,} of {name!r}" for name, count in left_out.items())
        raise SampleFolderError(f"the table was built without broken samples ({counts}); --allow-broken accepts that")


def _chosen(table: str | None, figure: str | None, calibrate: bool, paper: str) -> "dict[str, Table]":
    """The chosen tables by number; raises `UsageError` without a choice, or for an unknown one."""
    from eval.tables.table import find_table

    known = plugins.names("TABLES")
    if sum((table is not None, figure is not None, calibrate)) != 1:
        listed = ", ".join(known)
        raise UsageError(f"give --table NUMBER, --figure NUMBER or --calibrate; installed tables: {listed}")
    if calibrate:
        from eval.tables.calibration import TABLE

        return {"calibration": TABLE}
    numbers = [str(table) if figure is None else f"figure{figure}"]
    if table == ALL:
        numbers = [name.removeprefix(f"{paper}-") for name in known if name.startswith(f"{paper}-")]
    if not numbers:
        raise UsageError(f"no table of {paper!r} is installed")
    return {number: find_table(paper, number) for number in numbers}


def framerates(text: str, option: str) -> "tuple[Fraction, ...]":
    """Framerates as they are given to an option; raises `UsageError`."""
    from motionkit.core.timegrid import parse_fps

    try:
        return tuple(parse_fps(part.strip()) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"{option} {text}: {error}") from None


def _sizes(text: str) -> tuple[int, int]:
    """The fewest and the most poses of a clip."""
    low, _, high = text.partition(":")
    with suppress(ValueError):
        if 8 <= int(low) <= int(high):
            return int(low), int(high)
    raise UsageError(f"--sizes {text}: give numbers of poses such as 16:64, at least 8")


def _encoder(pair: str, runs: Path) -> tuple[str, Path]:
    name, separator, run = pair.partition("=")
    if not separator or not name or not run:
        raise UsageError(f"--encoder {pair}: give NAME=RUN, such as liif=wide for the LIIF of runs/wide")
    if not (runs / run).is_dir():
        raise UsageError(f"--encoder {pair}: there is no run {str(runs / run)!r}")
    return name, runs / run


def named_samples(pairs: list[str], run: Path | None = None) -> dict[str, Path]:
    """Folders of samples by name; raises `UsageError` for a name twice, or of a row of the run's models."""
    from eval.sets.sets import check_sample_names
    from motionkit.generate.models import installed_models

    named: dict[str, Path] = {}
    for pair in pairs:
        name, separator, folder = pair.partition("=")
        if not separator or not name or not folder:
            raise UsageError(f"--samples {pair}: give NAME=DIR")
        if name in named:
            raise UsageError(f"--samples {pair}: there are samples of this name already; give every folder its own")
        named[name] = Path(folder)
    if named:
        loaders = installed_models().values()
        check_sample_names(named, [each.title for each in loaders if run is not None and each.begun_in(run)])
    return named


def _build_all(config: "EvalConfig", tables: "dict[str, Table]", as_json: bool) -> None:
    """Build every table in turn; raises `UsageError` at the end, with reasons, if some could not be built."""
    results, lacking = [], []
    for number, table in tables.items():
        try:
            result = _build(config, table)
            results.append(result)
            _refuse_rowless(config, result)
        except MotionkitError as error:
            lacking.append(f"{number}: {error}")
            continue
        if not as_json:
            _show(result)
    if as_json:
        print_json([asdict(result) for result in results])
    if lacking:
        raise UsageError(f"{len(results)} of {len(tables)} were built. " + "; ".join(lacking))


def _build(config: "EvalConfig", table: "Table") -> "Result":
    """Build and write a table."""
    from eval.report.render import to_markdown
    from eval.report.results import write_result

    if config.samples and not table.takes_samples:
        raise UsageError(f"{table.title!r} has no rows of samples: leave out --samples")
    result = table.build(config)
    run, loaders = config.run, table.shown().values()
    lacking = [each.title for each in loaders if run is None or not each.complete_in(run)]
    if lacking:
        paper = "" if table.is_default else f" --paper {table.paper}"
        named = "" if run is None or run.name == "nano" else f" --run {shlex.quote(run.name)}"
        command = f"motionkit train --for {table.target}{paper}{named}"
        stderr.print(f"no rows of {', '.join(lacking)}: {command} trains the missing ones")
    path = write_result(result, config.results)
    write_whole(path.with_suffix(".md"), to_markdown(result))
    stderr.print(f"written: {path}, beside it {path.with_suffix('.md').name}")
    return result


def _refuse_rowless(config: "EvalConfig", result: "Result") -> None:
    """Raise if samples have no row of scores in the table, with the reason."""
    from eval.sample_folder import SampleFolderError

    # Blocks without a metric, such as that of copies, are no scores.
    shown = {row.name for block in result.blocks if block.metrics for row in block.rows if row.cells}
    rowless = [name for name in config.samples if name not in shown]
    for name in rowless:
        # The lines of "MDM, 50 steps" are not those of "MDM".
        others = tuple(each for each in config.samples if each.startswith(f"{name}, "))
        reasons = [
            line
            for line in result.missing
            if line.startswith((f"{name}:", f"{name}, ")) and not (others and line.startswith(others))
        ]
        stderr.print(f"no row for {reasons[0] if reasons else name}")
    if rowless:
        raise SampleFolderError(f"the table was written without rows for {', '.join(map(repr, rowless))}")


def _print_left_out(config: "EvalConfig") -> None:
    """Read the samples, and name those that are left out."""
    for folder in config.sample_folders:
        for problem in folder.left_out[:SHOWN_PROBLEMS]:
            stderr.print(f"left out of {folder.name!r}: {problem}")
        if len(folder.left_out) > SHOWN_PROBLEMS:
            stderr.print(f"… and {len(folder.left_out) - SHOWN_PROBLEMS:,} more: motionkit samples FOLDER")


def _show(result: "Result", as_json: bool = False) -> None:
    """Print a result: as JSON, as tables of the terminal's width, or as Markdown."""
    from eval.report.render import to_markdown
    from eval.report.results import format_cell
    from motionkit.cli.console import print_table

    if as_json:
        print_json(asdict(result))
    elif not stdout.is_terminal:
        print_text(to_markdown(result))
    else:
        # Notes and further metrics are in the file.
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
