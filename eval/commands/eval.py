"""`motionkit eval`: build a table or a figure, or calibrate the feature sets."""

import shlex
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.cli.console import parse_rate, print_json, print_text, progress, stderr, stdout
from motionkit.core import plugins
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import default_path, write_whole

if TYPE_CHECKING:
    from fractions import Fraction

    from eval.report.results import Result
    from eval.tables.table import EvalConfig, Table

ALL = "all"
REAL, EVALUATED, EVALUATOR = "Real motion", "What is evaluated", "Evaluator"
CLIPS = "clip-FID (table 2, figures, --calibrate)"
PROTOCOL = "Protocol of whole motions (tables 1 and 3)"
EVALUATORS = "kinematic,native,guo,motion-clip,tmr; all there are. Of actions: linear, …"
PROTOCOLS = "native, nerm, t2m, mdm, mld, t2m-gpt, momask, mardm, tmr, kimodo; of actions: a2m, …"


def _option(panel: str, help: str, *names: str, **more: Any) -> Any:
    return typer.Option(*names, help=help, rich_help_panel=panel, **more)


def evaluate(
    table: Annotated[str | None, typer.Option(help="Number of the paper's table; all: every one, figures too.")] = None,
    figure: Annotated[str | None, typer.Option(help="Figure to build as a table, by its number: 5, 8.")] = None,
    calibrate: Annotated[bool, typer.Option("--calibrate", help="Check that clip-FID rises with damage.")] = False,
    paper: Annotated[str, typer.Option(help="Paper whose table is meant.")] = "nerm",
    results: Annotated[Path | None, typer.Option(help="Folder for the JSON result and its Markdown table.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    store: Annotated[Path | None, _option(REAL, "Store with the real motion.")] = None,
    split: Annotated[str, _option(REAL, "Real sequences to compare with: a split, or all.")] = "test",
    where: Annotated[str | None, _option(REAL, "Only real sequences for which this holds.", metavar="SQL")] = None,
    runs: Annotated[Path | None, _option(EVALUATED, "Folder of all runs.")] = None,
    run: Annotated[
        str | None,
        _option(EVALUATED, "Trained run to evaluate; without one its rows are left out.", show_default="nano"),
    ] = None,
    samples: Annotated[
        list[str] | None,
        _option(EVALUATED, "Another system's motions; with @FPS for that column alone.", metavar="NAME[@FPS]=DIR"),
    ] = None,
    samples_fps: Annotated[str | None, _option(EVALUATED, "Framerate of samples without one.", metavar="FPS")] = None,
    encoder: Annotated[list[str] | None, _option(EVALUATED, "Another run's encoder.", metavar="NAME=RUN")] = None,
    motions: Annotated[int, _option(EVALUATED, "Maximum number of motions that a model generates.", min=2)] = 1024,
    draws: Annotated[int, _option(EVALUATED, "How often a model generates the set (published: 20).", min=1)] = 1,
    fps: Annotated[str | None, _option(CLIPS, "Framerates, such as 20,60,120; the table's own by default.")] = None,
    clips: Annotated[int, _option(CLIPS, "Clips on each side (N).", min=64)] = 4096,
    replications: Annotated[int, _option(CLIPS, "Independent repetitions behind the intervals.", min=1)] = 20,
    sizes: Annotated[str, _option(CLIPS, "Clip sizes in poses.")] = "16:64",
    evaluator: Annotated[str | None, _option(EVALUATOR, EVALUATORS)] = None,
    weights: Annotated[Path | None, _option(EVALUATOR, "The published evaluator's file.", metavar="FILE")] = None,
    glove: Annotated[Path | None, _option(EVALUATOR, "Its word vectors: our_vab_data.npy, …", metavar="DIR")] = None,
    statistics: Annotated[Path | None, _option(EVALUATOR, "Its mean.npy and std.npy.", metavar="DIR")] = None,
    motion_clip: Annotated[Path | None, _option(EVALUATOR, "MARDM's MotionCLIP, finest.tar …", metavar="DIR")] = None,
    protocol: Annotated[str, _option(PROTOCOL, PROTOCOLS)] = "native",
) -> None:
    """Build one of the papers' tables or figures, or calibrate the features that clip-FID is computed on.

    Example: motionkit eval --table 2
    """
    from eval.clip_fid.score import Protocol
    from eval.sample_folder import SampleFolderError, SampleOptions
    from eval.tables.table import EvalConfig, name_and_fps
    from motionkit.training.run import DEFAULT_RUN, find_run

    tables = _chosen(table, figure, calibrate, paper)
    if calibrate and samples:
        raise UsageError("--calibrate damages real motion by itself: leave out --samples")
    guo = None
    if weights is not None:
        from eval.text_motion.guo import GuoFiles

        guo = GuoFiles(weights, glove, statistics)
    elif glove or statistics:
        raise UsageError("--glove and --statistics need a published evaluator: give its --weights finest.tar")
    folder = runs or default_path("runs")
    place = find_run(run or DEFAULT_RUN, folder)
    own = place if not samples or place.is_dir() else None
    if own is None and run is not None:
        stderr.print(f"there is no run {str(place)!r}: only --samples have rows")
    encoders = tuple((name, folder / of) for name, of in _pairs("--encoder", encoder or [], "RUN"))
    if absent := [path for _, path in encoders if not path.is_dir()]:
        raise UsageError(f"--encoder: there is no run {str(absent[0])!r}")
    config = EvalConfig(
        store=store or default_path("store"),
        results=results or default_path("results"),
        split=split,
        where=where,
        run=own,
        samples=named_samples(samples or [], own),
        sample_options=SampleOptions(parse_rate(samples_fps, "--samples-fps")),
        encoders=encoders,
        max_motions=motions,
        draws=draws,
        evaluators=tuple(evaluator.split(",")) if evaluator else None,
        guo=guo,
        motion_clip=motion_clip,
        clips=Protocol(*_sizes(sizes), num_clips=clips, replications=replications, seed=seed),
        protocol=protocol,
        fps=framerates(fps, "--fps") if fps else None,
        seed=seed,
    )
    failed: dict[str, MotionkitError] = {}
    built = []
    with progress() as show:
        config = replace(config, on_progress=show)
        for folder_of in config.sample_folders if any(each.takes_samples for each in tables.values()) else ():
            for problem in folder_of.left_out[:10]:
                stderr.print(f"left out of {folder_of.name!r}: {problem}")
        for number, each in tables.items():
            try:
                built.append(_build(config, each, as_json))
            except MotionkitError as error:
                failed[number] = error
    if as_json and (built or table == ALL):
        print_json([asdict(result) for result in built] if table == ALL else asdict(built[0]))
    if failed and table == ALL:
        reasons = "; ".join(f"{number}: {error}" for number, error in failed.items())
        raise UsageError(f"{len(built)} of {len(tables)} were built. {reasons}")
    for reason in failed.values():
        raise reason
    for result in built:
        shown = {row.name for block in result.blocks if block.metrics for row in block.rows if row.cells}
        if rowless := [name for name in config.samples if not {name, name_and_fps(name)[0]} & shown]:
            reasons = "; ".join(line for line in result.missing if line.startswith(tuple(rowless)))
            raise SampleFolderError(f"the table was written without rows for {', '.join(rowless)}; {reasons}")
    if left_out := {each.name: len(each.left_out) for each in config.sample_folders if each.left_out}:
        counts = ", ".join(f"{count:,} of {name!r}" for name, count in left_out.items())
        raise SampleFolderError(f"the table was built without broken samples ({counts}): motionkit samples FOLDER")


def _chosen(table: str | None, figure: str | None, calibrate: bool, paper: str) -> "dict[str, Table]":
    """The chosen tables by number; raises `UsageError` without a choice, or for an unknown one."""
    from eval.tables.table import find_table

    known = plugins.names("TABLES")
    if sum((table is not None, figure is not None, calibrate)) != 1:
        raise UsageError(
            f"give --table NUMBER (2: clip-FID), --figure NUMBER or --calibrate; installed tables: {', '.join(known)}"
        )
    if calibrate:
        from eval.tables.calibration import TABLE

        return {"calibration": TABLE}
    numbers = [str(table) if figure is None else f"figure{figure}"]
    if table == ALL:
        numbers = [name.removeprefix(f"{paper}-") for name in known if name.startswith(f"{paper}-")]
    return {number: find_table(paper, number) for number in numbers or [ALL]}


def framerates(text: str, option: str) -> "tuple[Fraction, ...]":
    """Framerates as they are given to an option; raises `UsageError`."""
    return tuple(rate for each in text.split(",") if (rate := parse_rate(each.strip(), option)) is not None)


def _sizes(text: str) -> tuple[int, int]:
    """The fewest and the most poses of a clip."""
    low, _, high = text.partition(":")
    with suppress(ValueError):
        if 8 <= int(low) <= int(high):
            return int(low), int(high)
    raise UsageError(f"--sizes {text}: give numbers of poses such as 16:64, at least 8")


def _pairs(option: str, pairs: list[str], value: str) -> list[tuple[str, str]]:
    """NAME=VALUE pairs of an option; raises `UsageError` for anything else."""
    named = []
    for pair in pairs:
        name, _, text = pair.partition("=")
        if not name or not text:
            raise UsageError(f"{option} {pair}: give NAME={value}")
        named.append((name, text))
    return named


def named_samples(pairs: list[str], run: Path | None = None) -> dict[str, Path]:
    """Folders of samples by name; raises `UsageError` for a name twice, or of a row of the run's models."""
    from eval.sets.sets import check_sample_names
    from eval.tables.table import name_and_fps
    from motionkit.generate.models import installed_models

    named: dict[str, Path] = {}
    for name, folder in _pairs("--samples", pairs, "DIR"):
        if name in named:
            raise UsageError(f"--samples {name}={folder}: there are samples of this name already")
        named[name] = Path(folder)
    if named:
        loaders = installed_models().values()
        # Folders of one system for several framerates are one row.
        systems = dict.fromkeys((system, fps is None) for system, fps in map(name_and_fps, named))
        models = [each.title for each in loaders if run is not None and each.begun_in(run)]
        check_sample_names([system for system, _ in systems], models)
    return named


def _build(config: "EvalConfig", table: "Table", as_json: bool) -> "Result":
    """Build a table, write it, and print it unless `as_json`."""
    from eval.report.results import to_markdown, write_result
    from motionkit.cli.console import print_table

    if config.samples and not table.takes_samples:
        raise UsageError(f"{table.title!r} has no rows of samples: leave out --samples")
    result = table.build(config)
    run, loaders = config.run, table.shown().values()
    lacking = [] if run is None else [each.title for each in loaders if not each.complete_in(run)]
    if run is not None and lacking:
        paper = "" if table.is_default else f" --paper {table.paper}"
        named = "" if run.name == "nano" else f" --run {shlex.quote(run.name)}"
        command = f"motionkit train --for {table.target}{paper}{named}"
        stderr.print(f"no rows of {', '.join(lacking)}: {command} trains the missing ones")
    path, text = write_result(result, config.results), to_markdown(result)
    write_whole(path.with_suffix(".md"), text)
    stderr.print(f"written: {path}, beside it {path.with_suffix('.md').name}")
    if not as_json and not stdout.is_terminal:
        print_text(text)
    elif not as_json:
        # Notes and further metrics are in the file.
        for line in (result.title, result.caption, *result.missing):
            stdout.print(line, soft_wrap=False)
        for block in result.blocks:
            stdout.print(f"\n{block.title}")
            print_table(block.columns, block.texts())
    return result
