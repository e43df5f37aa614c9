"""`motionkit eval`: build a table or a figure, or calibrate the feature sets."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.console import print_json, stderr
from motionkit.errors import UsageError
from motionkit.settings import default_path

if TYPE_CHECKING:
    from fractions import Fraction

    from eval.clip_fid import PoseRange, SecondsRange
    from eval.evaluators.guo_files import GuoFiles
    from eval.tables.registry import TableRequest

DEFAULT_RUN = "nano"
SHOWN_PROBLEMS = 10
# Where options stand in --help.
REAL = "Real motion"
EVALUATED = "What is evaluated"
CLIPS = "clip-FID (table 2, figures, --calibrate)"
EVALUATOR = "Evaluator"
PROTOCOL = "Protocol of whole motions (tables 1 and 3)"


def evaluate(
    table: Annotated[str | None, typer.Option(help="Table to build, by its number in the paper.")] = None,
    figure: Annotated[str | None, typer.Option(help="Figure to build as a table, by its number: 5, 8.")] = None,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="Check that clip-FID rises with damage, and only with damage.")
    ] = False,
    paper: Annotated[str, typer.Option(help="Paper whose table is meant.")] = "nerm",
    store: Annotated[Path | None, typer.Option(help="Store with the real motion.", rich_help_panel=REAL)] = None,
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.", rich_help_panel=EVALUATED)] = None,
    run: Annotated[
        str,
        typer.Option(
            help="Trained run to evaluate; its rows are left out where there is none.", rich_help_panel=EVALUATED
        ),
    ] = (DEFAULT_RUN),
    results: Annotated[Path | None, typer.Option(help="Folder for the JSON result and its Markdown table.")] = None,
    split: Annotated[
        str, typer.Option(help="Real sequences to compare with: a split, or all.", rich_help_panel=REAL)
    ] = "test",
    where: Annotated[
        str | None,
        typer.Option(
            metavar="SQL",
            help='Compare only with real sequences for which this holds too: "len(quality_flags) = 0".',
            rich_help_panel=REAL,
        ),
    ] = None,
    fps: Annotated[
        str | None,
        typer.Option(help="Framerates, such as 20,60,120; the table's own by default.", rich_help_panel=CLIPS),
    ] = None,
    clips: Annotated[int, typer.Option(min=64, help="Clips on each side (N).", rich_help_panel=CLIPS)] = 4096,
    replications: Annotated[
        int, typer.Option(min=1, help="Independent repetitions behind the intervals.", rich_help_panel=CLIPS)
    ] = 20,
    sizes: Annotated[
        str, typer.Option(help="Clip sizes: poses 16:64, or seconds 0.4s:1.6s.", rich_help_panel=CLIPS)
    ] = "16:64",
    samples: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=DIR",
            help="A folder of another system's motions, as a row (docs/samples.md).",
            rich_help_panel=EVALUATED,
        ),
    ] = None,
    samples_fps: Annotated[
        str | None,
        typer.Option(
            "--samples-fps",
            metavar="FPS",
            help="Framerate of samples whose files do not say it.",
            rich_help_panel=EVALUATED,
        ),
    ] = None,
    allow_broken: Annotated[
        bool,
        typer.Option(
            "--allow-broken",
            help="Exit with 0 although samples that cannot be read, or hold NaN, were left out.",
            rich_help_panel=EVALUATED,
        ),
    ] = False,
    low_pass: Annotated[
        float | None,
        typer.Option(
            "--low-pass", min=0.1, metavar="HZ", help="Smooth every set, real ones too, first.", rich_help_panel=CLIPS
        ),
    ] = None,
    evaluator: Annotated[
        str | None,
        typer.Option(
            "--evaluator",
            "--features",
            help="Feature sets: kinematic,native,guo; all there are. Of actions: linear, humanact12, uestc, cmu-mocap.",
            rich_help_panel=EVALUATOR,
        ),
    ] = None,
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The published evaluator's or recogniser's file: finest.tar, ….tar.",
            rich_help_panel=EVALUATOR,
        ),
    ] = None,
    glove: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Its word vectors: our_vab_data.npy, _words.pkl, _idx.pkl.", rich_help_panel=EVALUATOR
        ),
    ] = None,
    statistics: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Its mean.npy and std.npy; those beside the weights by default.",
            rich_help_panel=EVALUATOR,
        ),
    ] = None,
    motions: Annotated[
        int, typer.Option(min=2, help="Most motions that a model generates.", rich_help_panel=EVALUATED)
    ] = 1024,
    protocol: Annotated[
        str,
        typer.Option(
            help="Of whole motions: native, t2m, mdm, mld, t2m-gpt, momask; of actions: a2m, actor, mdm.",
            rich_help_panel=PROTOCOL,
        ),
    ] = "native",
    compat: Annotated[
        str | None,
        typer.Option(
            metavar="BUGS", help="Known bugs of that protocol's code to switch on, by name.", rich_help_panel=PROTOCOL
        ),
    ] = None,
    draws: Annotated[
        int,
        typer.Option(
            min=1,
            help="How often a model generates the whole set; 20 as published protocols do.",
            rich_help_panel=EVALUATED,
        ),
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Build one of the papers' tables or figures, or calibrate the features that clip-FID is computed on."""
    from eval.clip_fid import Protocol
    from eval.sample_folder import SampleOptions
    from eval.tables.registry import TableRequest, installed_tables

    if sum((table is not None, figure is not None, calibrate)) != 1:
        known = ", ".join(installed_tables())
        raise UsageError(f"give --table NUMBER, --figure NUMBER or --calibrate; installed tables: {known}")
    if calibrate and (low_pass is not None or samples):
        raise UsageError("--calibrate damages real motion by itself: leave out --low-pass and --samples")
    request = TableRequest(
        store=store or default_path("store"),
        results=results or default_path("results"),
        run=(runs or default_path("runs")) / run,
        split=split,
        where=where,
        fps=_framerates(fps),
        protocol=Protocol(sizes=_sizes(sizes), num_clips=clips, replications=replications, seed=seed),
        samples=_samples(samples or []),
        sample_options=SampleOptions(_framerate(samples_fps)),
        features=tuple(evaluator.split(",")) if evaluator else None,
        guo=_guo_files(weights, glove, statistics),
        low_pass_hz=low_pass,
        max_motions=motions,
        published=protocol,
        compat=tuple(compat.split(",")) if compat else (),
        draws=draws,
        seed=seed,
    )
    _build(request, table if figure is None else f"figure{figure}", paper, as_json)
    if not allow_broken:
        _refuse_broken(request)


def _refuse_broken(request: "TableRequest") -> None:
    """Name every sample that the table does without, and end with exit code 1."""
    from eval.sample_folder import SampleFolderError

    incomplete = [folder for folder in request.sample_folders if folder.left_out]
    for folder in incomplete:
        for problem in folder.left_out[:SHOWN_PROBLEMS]:
            stderr.print(f"left out of {folder.name!r}: {problem}", markup=False)
        if len(folder.left_out) > SHOWN_PROBLEMS:
            stderr.print(
                f"… and {len(folder.left_out) - SHOWN_PROBLEMS:,} more: motionkit samples FOLDER", markup=False
            )
    if incomplete:
        names = ", ".join(f"{len(folder.left_out):,} of {folder.name!r}" for folder in incomplete)
        raise SampleFolderError(f"the table was built without broken samples ({names}); --allow-broken accepts that")


def _build(request: "TableRequest", table: str | None, paper: str, as_json: bool) -> None:
    from dataclasses import asdict

    from eval.report.render import to_markdown
    from eval.report.results import write_result
    from eval.tables.calibration import build_calibration
    from eval.tables.registry import find_table

    build = build_calibration if table is None else find_table(paper, table).build
    result = build(request)
    path = write_result(result, request.results)
    if result.figure:
        from eval.report.calibration_figure import calibration_figure
        from eval.report.figures import save

        save(calibration_figure(result), request.results / result.figure)
    text = to_markdown(result)
    path.with_suffix(".md").write_text(text, encoding="utf-8")
    if as_json:
        print_json(asdict(result))
    else:
        print(text, end="")
    beside = " and ".join(filter(None, (path.with_suffix(".md").name, result.figure)))
    stderr.print(f"written: {path}, beside it {beside}", markup=False)


def _guo_files(weights: Path | None, glove: Path | None, statistics: Path | None) -> "GuoFiles | None":
    from eval.evaluators.guo_files import GuoFiles

    if weights is None:
        unused = next((name for name, path in (("--glove", glove), ("--statistics", statistics)) if path), None)
        if unused is not None:
            raise UsageError(f"{unused} belongs to a published evaluator: name its weights with --weights finest.tar")
        return None
    return GuoFiles(weights, glove, statistics)


def _framerate(text: str | None) -> "Fraction | None":
    from motionkit.timegrid import parse_fps

    try:
        return None if text is None else parse_fps(text)
    except ValueError as error:
        raise UsageError(f"--samples-fps {text}: {error}") from None


def _framerates(text: str | None) -> "tuple[Fraction, ...] | None":
    from motionkit.timegrid import parse_fps

    if text is None:
        return None
    try:
        return tuple(parse_fps(part.strip()) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"--fps {text}: {error}") from None


def _sizes(text: str) -> "PoseRange | SecondsRange":
    from eval.clip_fid import PoseRange, SecondsRange

    low, _, high = text.partition(":")
    try:
        if low.endswith("s") and high.endswith("s"):
            seconds = SecondsRange(float(low[:-1]), float(high[:-1]))
            valid = 0 < seconds.minimum <= seconds.maximum
            chosen: PoseRange | SecondsRange = seconds
        else:
            poses = PoseRange(int(low), int(high))
            valid = 8 <= poses.minimum <= poses.maximum
            chosen = poses
    except ValueError:
        valid = False
    if not valid:
        raise UsageError(f"--sizes {text}: give poses such as 16:64 (at least 8), or seconds such as 0.4s:1.6s")
    return chosen


def _samples(pairs: list[str]) -> dict[str, Path]:
    named = {}
    for pair in pairs:
        name, separator, folder = pair.partition("=")
        if not separator or not name or not folder:
            raise UsageError(f"--samples {pair}: give NAME=DIR")
        named[name] = Path(folder)
    return named
