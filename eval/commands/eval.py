"""`motionkit eval`: build a table or a figure, or calibrate the feature sets."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from eval.commands import eval_options
from motionkit.cli.console import print_json, print_text, progress, stderr
from motionkit.core.errors import UsageError
from motionkit.core.files import write_whole
from motionkit.core.settings import default_path

if TYPE_CHECKING:
    from fractions import Fraction

    from eval.clip_fid.score import PoseRange, SecondsRange
    from eval.report.results import Result
    from eval.tables.registry import TableRequest
    from eval.text_motion.guo.kind import GuoFiles

DEFAULT_RUN = "nano"
SHOWN_PROBLEMS = 10


def evaluate(
    table: eval_options.TableNumber = None,
    figure: eval_options.FigureNumber = None,
    calibrate: eval_options.Calibrate = False,
    paper: eval_options.Paper = "nerm",
    store: eval_options.StorePath = None,
    runs: eval_options.RunsFolder = None,
    run: eval_options.RunName = DEFAULT_RUN,
    results: eval_options.ResultsFolder = None,
    split: eval_options.Split = "test",
    where: eval_options.Where = None,
    fps: eval_options.Framerates = None,
    clips: eval_options.NumClips = 4096,
    replications: eval_options.Replications = 20,
    sizes: eval_options.ClipSizes = "16:64",
    samples: eval_options.SampleFolders = None,
    samples_fps: eval_options.SamplesFps = None,
    allow_broken: eval_options.AllowBroken = False,
    encoder: eval_options.Encoders = None,
    low_pass: eval_options.LowPass = None,
    evaluator: eval_options.Evaluators = None,
    weights: eval_options.Weights = None,
    glove: eval_options.Glove = None,
    statistics: eval_options.StatisticsFolder = None,
    motions: eval_options.MostMotions = 1024,
    protocol: eval_options.ProtocolName = "native",
    compat: eval_options.Compat = None,
    draws: eval_options.Draws = 1,
    seed: eval_options.Seed = 0,
    as_json: eval_options.AsJson = False,
) -> None:
    """Build one of the papers' tables or figures, or calibrate the features that clip-FID is computed on."""
    from eval.clip_fid.score import Protocol
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
        encoders=_encoders(encoder or [], runs or default_path("runs")),
    )
    with progress() as show:
        request = replace(request, on_progress=show)
        result = _build(request, table if figure is None else f"figure{figure}", paper, as_json)
    _refuse_rowless(request, result)
    if not allow_broken:
        _refuse_broken(request)


def _refuse_rowless(request: "TableRequest", result: "Result") -> None:
    """End with exit code 1 where samples that were given have no row in the table, with the reason."""
    from eval.sample_folder import SampleFolderError
    from eval.tables.nerm.clip_fid_column import TITLE as COPIES

    scored = [block for block in result.blocks if block.title != COPIES]
    shown = {row.name for block in scored for row in block.rows if row.cells}
    rowless = [name for name in request.samples if name not in shown]
    for name in rowless:
        told = [line for line in result.missing if line.startswith(name)]
        stderr.print(f"no row for {told[0] if told else name}")
    if rowless:
        raise SampleFolderError(f"the table was written without rows for {', '.join(map(repr, rowless))}")


def _refuse_broken(request: "TableRequest") -> None:
    """Name every sample that the table does without, and end with exit code 1."""
    from eval.sample_folder import SampleFolderError

    incomplete = [folder for folder in request.sample_folders if folder.left_out]
    for folder in incomplete:
        for problem in folder.left_out[:SHOWN_PROBLEMS]:
            stderr.print(f"left out of {folder.name!r}: {problem}")
        if len(folder.left_out) > SHOWN_PROBLEMS:
            stderr.print(f"… and {len(folder.left_out) - SHOWN_PROBLEMS:,} more: motionkit samples FOLDER")
    if incomplete:
        names = ", ".join(f"{len(folder.left_out):,} of {folder.name!r}" for folder in incomplete)
        raise SampleFolderError(f"the table was built without broken samples ({names}); --allow-broken accepts that")


def _build(request: "TableRequest", table: str | None, paper: str, as_json: bool) -> "Result":
    """Build, write and print a table (None: the calibration)."""
    from dataclasses import asdict

    from eval.report.render import to_markdown
    from eval.report.results import write_result
    from eval.tables.calibration import build_calibration
    from eval.tables.registry import find_table

    if table is None:
        result = build_calibration(request)
    else:
        found = find_table(paper, table)
        if request.samples and not found.takes_samples:
            raise UsageError(f"{found.title!r} has no rows of samples: leave out --samples")
        result = found.build(request)
    path = write_result(result, request.results)
    if result.figure:
        from eval.report.curves import calibration_figure
        from eval.report.figures import save

        save(calibration_figure(result), request.results / result.figure)
    text = to_markdown(result)
    write_whole(path.with_suffix(".md"), text)
    if as_json:
        print_json(asdict(result))
    else:
        print_text(text)
    beside = " and ".join(filter(None, (path.with_suffix(".md").name, result.figure)))
    stderr.print(f"written: {path}, beside it {beside}")
    return result


def _guo_files(weights: Path | None, glove: Path | None, statistics: Path | None) -> "GuoFiles | None":
    from eval.text_motion.guo.kind import GuoFiles

    if weights is None:
        unused = next((name for name, path in (("--glove", glove), ("--statistics", statistics)) if path), None)
        if unused is not None:
            raise UsageError(f"{unused} belongs to a published evaluator: name its weights with --weights finest.tar")
        return None
    return GuoFiles(weights, glove, statistics)


def _framerate(text: str | None) -> "Fraction | None":
    from motionkit.core.timegrid import parse_fps

    try:
        return None if text is None else parse_fps(text)
    except ValueError as error:
        raise UsageError(f"--samples-fps {text}: {error}") from None


def _framerates(text: str | None) -> "tuple[Fraction, ...] | None":
    from motionkit.core.timegrid import parse_fps

    if text is None:
        return None
    try:
        return tuple(parse_fps(part.strip()) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"--fps {text}: {error}") from None


def _sizes(text: str) -> "PoseRange | SecondsRange":
    from eval.clip_fid.score import PoseRange, SecondsRange

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


def _encoders(pairs: list[str], runs: Path) -> tuple[tuple[str, Path], ...]:
    named = []
    for pair in pairs:
        name, separator, run = pair.partition("=")
        if not separator or not name or not run:
            raise UsageError(f"--encoder {pair}: give NAME=RUN, such as liif=wide for the LIIF of runs/wide")
        if not (runs / run).is_dir():
            raise UsageError(f"--encoder {pair}: there is no run {str(runs / run)!r}")
        named.append((name, runs / run))
    return tuple(named)


def _samples(pairs: list[str]) -> dict[str, Path]:
    if not pairs:
        return {}
    from motionkit.generate.models import installed_models

    own = ("real,", "real (", *(loader.title for loader in installed_models().values()))
    named: dict[str, Path] = {}
    for pair in pairs:
        name, separator, folder = pair.partition("=")
        if not separator or not name or not folder:
            raise UsageError(f"--samples {pair}: give NAME=DIR")
        if name in named:
            raise UsageError(f"--samples {pair}: there are samples of this name already; give every folder its own")
        if name == "real" or name.startswith(own):
            raise UsageError(f"--samples {pair}: tables have a row {name!r} of their own; choose another name")
        named[name] = Path(folder)
    return named
