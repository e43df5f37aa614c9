"""The options of `motionkit eval`, in groups, and their conversion to the requests that tables take."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.core.errors import UsageError
from motionkit.core.files import default_path

if TYPE_CHECKING:
    from fractions import Fraction

    from eval.clip_fid.clips import PoseRange, SecondsRange
    from eval.tables.registry import ClipFidSettings, Evaluated, Evaluators, PublishedProtocol, RealMotions

# Panels of --help.
REAL = "Real motion"
EVALUATED = "What is evaluated"
CLIPS = "clip-FID (table 2, figures, --calibrate)"
EVALUATOR = "Evaluator"
PROTOCOL = "Protocol of whole motions (tables 1 and 3)"

ALL = "all"
TableNumber = Annotated[
    str | None, typer.Option(help="Table to build, by its number in the paper; all: every table and figure.")
]
FigureNumber = Annotated[str | None, typer.Option(help="Figure to build as a table, by its number: 5, 8.")]
Calibrate = Annotated[
    bool, typer.Option("--calibrate", help="Check that clip-FID rises with damage, and only with damage.")
]
Paper = Annotated[str, typer.Option(help="Paper whose table is meant.")]
StorePath = Annotated[Path | None, typer.Option(help="Store with the real motion.", rich_help_panel=REAL)]
RunsFolder = Annotated[Path | None, typer.Option(help="Folder of all runs.", rich_help_panel=EVALUATED)]
RunName = Annotated[
    str,
    typer.Option(help="Trained run to evaluate; its rows are left out where there is none.", rich_help_panel=EVALUATED),
]
ResultsFolder = Annotated[Path | None, typer.Option(help="Folder for the JSON result and its Markdown table.")]
Split = Annotated[str, typer.Option(help="Real sequences to compare with: a split, or all.", rich_help_panel=REAL)]
Where = Annotated[
    str | None,
    typer.Option(
        metavar="SQL",
        help='Compare only with real sequences for which this holds too: "len(quality_flags) = 0".',
        rich_help_panel=REAL,
    ),
]
Framerates = Annotated[
    str | None,
    typer.Option(help="Framerates, such as 20,60,120; the table's own by default.", rich_help_panel=CLIPS),
]
NumClips = Annotated[int, typer.Option(min=64, help="Clips on each side (N).", rich_help_panel=CLIPS)]
Replications = Annotated[
    int, typer.Option(min=1, help="Independent repetitions behind the intervals.", rich_help_panel=CLIPS)
]
ClipSizes = Annotated[str, typer.Option(help="Clip sizes: poses 16:64, or seconds 0.4s:1.6s.", rich_help_panel=CLIPS)]
SampleFolders = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=DIR",
        help="A folder of another system's motions, as a row (docs/samples.md).",
        rich_help_panel=EVALUATED,
    ),
]
SamplesFps = Annotated[
    str | None,
    typer.Option(
        "--samples-fps",
        metavar="FPS",
        help="Framerate of samples whose files do not say it.",
        rich_help_panel=EVALUATED,
    ),
]
AllowBroken = Annotated[
    bool,
    typer.Option(
        "--allow-broken",
        help="Exit with 0 even if samples that are unreadable, hold NaN or are no bodies were left out.",
        rich_help_panel=EVALUATED,
    ),
]
Encoders = Annotated[
    list[str] | None,
    typer.Option(
        "--encoder",
        metavar="NAME=RUN",
        help="Of completed motion: another run's trained encoder, as a row: liif=wide.",
        rich_help_panel=EVALUATED,
    ),
]
LowPass = Annotated[
    float | None,
    typer.Option(
        "--low-pass", min=0.1, metavar="HZ", help="Smooth every set, real ones too, first.", rich_help_panel=CLIPS
    ),
]
EvaluatorNames = Annotated[
    str | None,
    typer.Option(
        "--evaluator",
        "--features",
        help="Feature sets: kinematic,native,guo,motion-clip,tmr; all there are. Of actions: linear, humanact12, …",
        rich_help_panel=EVALUATOR,
    ),
]
Weights = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="The published evaluator's or recogniser's file: finest.tar, ….tar.",
        rich_help_panel=EVALUATOR,
    ),
]
Glove = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Its word vectors: our_vab_data.npy, _words.pkl, _idx.pkl.", rich_help_panel=EVALUATOR
    ),
]
StatisticsFolder = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Its mean.npy and std.npy; those beside the weights by default.",
        rich_help_panel=EVALUATOR,
    ),
]
MotionClipFolder = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="MARDM's MotionCLIP: finest.tar, its statistics, CLIP's words.", rich_help_panel=EVALUATOR
    ),
]
MostMotions = Annotated[
    int, typer.Option(min=2, help="Maximum number of motions that a model generates.", rich_help_panel=EVALUATED)
]
ProtocolName = Annotated[
    str,
    typer.Option(
        help="Of texts: native, nerm, t2m, mdm, mld, t2m-gpt, momask, mardm, tmr, kimodo; of actions: a2m, …",
        rich_help_panel=PROTOCOL,
    ),
]
Compat = Annotated[
    str | None,
    typer.Option(
        metavar="BUGS", help="Known bugs of that protocol's code to switch on, by name.", rich_help_panel=PROTOCOL
    ),
]
Draws = Annotated[
    int,
    typer.Option(
        min=1,
        help="How often a model generates the whole set; published protocols: 20.",
        rich_help_panel=EVALUATED,
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Random seed.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


@dataclass(frozen=True)
class OutputOptions:
    """Where the result goes, and the random seed."""

    results: ResultsFolder = None
    seed: Seed = 0
    as_json: AsJson = False


@dataclass(frozen=True)
class TableOptions:
    """Which table: one of `table`, `figure` and `calibrate`."""

    table: TableNumber = None
    figure: FigureNumber = None
    calibrate: Calibrate = False
    paper: Paper = "nerm"

    @property
    def numbers(self) -> tuple[str | None, ...]:
        """The chosen tables' registered numbers; None for the calibration. Raises `UsageError` without a choice."""
        from eval.tables.registry import installed_tables

        if sum((self.table is not None, self.figure is not None, self.calibrate)) != 1:
            known = ", ".join(installed_tables())
            raise UsageError(f"give --table NUMBER, --figure NUMBER or --calibrate; installed tables: {known}")
        if self.table == ALL:
            names = (name.split("-", 1) for name in installed_tables())
            of_paper = tuple(number for paper, number in names if paper == self.paper)
            if not of_paper:
                raise UsageError(f"no table of {self.paper!r} is installed")
            return of_paper
        return (self.table if self.figure is None else f"figure{self.figure}",)


@dataclass(frozen=True)
class RealOptions:
    """What is compared with."""

    store: StorePath = None
    split: Split = "test"
    where: Where = None

    def chosen(self) -> "RealMotions":
        """As tables take it."""
        from eval.tables.registry import RealMotions

        return RealMotions(self.store or default_path("store"), self.split, self.where)


@dataclass(frozen=True)
class EvaluatedOptions:
    """What is evaluated."""

    runs: RunsFolder = None
    run: RunName = "nano"
    samples: SampleFolders = None
    samples_fps: SamplesFps = None
    allow_broken: AllowBroken = False
    encoder: Encoders = None
    motions: MostMotions = 1024
    draws: Draws = 1

    def chosen(self) -> "Evaluated":
        """As tables take it; raises `UsageError` for unknown names."""
        from eval.sample_folder import SampleOptions
        from eval.tables.registry import Evaluated

        runs = self.runs or default_path("runs")
        return Evaluated(
            run=runs / self.run,
            samples=_samples(self.samples or [], runs / self.run),
            sample_options=SampleOptions(_framerate(self.samples_fps, "--samples-fps")),
            encoders=tuple(_encoder(pair, runs) for pair in self.encoder or []),
            max_motions=self.motions,
            draws=self.draws,
        )


@dataclass(frozen=True)
class ClipOptions:
    """How clip-FID draws, and at which framerates."""

    fps: Framerates = None
    clips: NumClips = 4096
    replications: Replications = 20
    sizes: ClipSizes = "16:64"
    low_pass: LowPass = None

    def framerates(self) -> "tuple[Fraction, ...] | None":
        """The framerates; None for the table's own."""
        from motionkit.core.timegrid import parse_fps

        if self.fps is None:
            return None
        try:
            return tuple(parse_fps(part.strip()) for part in self.fps.split(","))
        except ValueError as error:
            raise UsageError(f"--fps {self.fps}: {error}") from None

    def chosen(self, seed: int) -> "ClipFidSettings":
        """As tables take it; raises `UsageError` for invalid sizes."""
        from eval.clip_fid.clips import Protocol
        from eval.tables.registry import ClipFidSettings

        protocol = Protocol(_sizes(self.sizes), num_clips=self.clips, replications=self.replications, seed=seed)
        return ClipFidSettings(protocol, self.low_pass)


@dataclass(frozen=True)
class EvaluatorOptions:
    """By what it is evaluated."""

    evaluator: EvaluatorNames = None
    weights: Weights = None
    glove: Glove = None
    statistics: StatisticsFolder = None
    motion_clip: MotionClipFolder = None

    def chosen(self) -> "Evaluators":
        """As tables take it; raises `UsageError` for files that no evaluator uses."""
        from eval.tables.registry import Evaluators
        from eval.text_motion.guo.kind import GuoFiles

        unused = [name for name, path in (("--glove", self.glove), ("--statistics", self.statistics)) if path]
        if self.weights is None and unused:
            raise UsageError(f"{unused[0]} needs a published evaluator: give its weights with --weights finest.tar")
        return Evaluators(
            tuple(self.evaluator.split(",")) if self.evaluator else None,
            None if self.weights is None else GuoFiles(self.weights, self.glove, self.statistics),
            self.motion_clip,
        )


@dataclass(frozen=True)
class ProtocolOptions:
    """The protocol of whole motions."""

    protocol: ProtocolName = "native"
    compat: Compat = None

    def chosen(self) -> "PublishedProtocol":
        """As tables take it."""
        from eval.tables.registry import PublishedProtocol

        return PublishedProtocol(self.protocol, tuple(self.compat.split(",")) if self.compat else ())


def in_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Flatten a command whose parameters are dataclasses of options into one with each option as a parameter."""
    parameters = inspect.signature(command).parameters
    groups: dict[str, Any] = {name: each.annotation for name, each in parameters.items()}
    flat = [
        inspect.Parameter(option.name, inspect.Parameter.KEYWORD_ONLY, default=option.default, annotation=option.type)
        for group in groups.values()
        for option in fields(group)
    ]

    @wraps(command)
    def run(**given: Any) -> None:
        command(
            **{
                name: group(**{option.name: given[option.name] for option in fields(group) if option.name in given})
                for name, group in groups.items()
            }
        )

    run.__signature__ = inspect.Signature(flat)  # type: ignore[attr-defined]
    run.__annotations__ = {option.name: option.annotation for option in flat}
    return run


def _framerate(text: str | None, option: str) -> "Fraction | None":
    from motionkit.core.timegrid import parse_fps

    try:
        return None if text is None else parse_fps(text)
    except ValueError as error:
        raise UsageError(f"{option} {text}: {error}") from None


def _sizes(text: str) -> "PoseRange | SecondsRange":
    from eval.clip_fid.clips import PoseRange, SecondsRange

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


def _encoder(pair: str, runs: Path) -> tuple[str, Path]:
    name, separator, run = pair.partition("=")
    if not separator or not name or not run:
        raise UsageError(f"--encoder {pair}: give NAME=RUN, such as liif=wide for the LIIF of runs/wide")
    if not (runs / run).is_dir():
        raise UsageError(f"--encoder {pair}: there is no run {str(runs / run)!r}")
    return name, runs / run


def _samples(pairs: list[str], run: Path) -> dict[str, Path]:
    if not pairs:
        return {}
    from eval.sets.row_ids import check_sample_names
    from motionkit.generate.models import installed_models

    named: dict[str, Path] = {}
    for pair in pairs:
        name, separator, folder = pair.partition("=")
        if not separator or not name or not folder:
            raise UsageError(f"--samples {pair}: give NAME=DIR")
        if name in named:
            raise UsageError(f"--samples {pair}: there are samples of this name already; give every folder its own")
        named[name] = Path(folder)
    check_sample_names(named, [loader.title for loader in installed_models().values() if loader.begun_in(run)])
    return named
