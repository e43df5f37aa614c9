"""The options of `motionkit eval`: their types and what the command line says of them."""

from pathlib import Path
from typing import Annotated

import typer

# Where options stand in --help.
REAL = "Real motion"
EVALUATED = "What is evaluated"
CLIPS = "clip-FID (table 2, figures, --calibrate)"
EVALUATOR = "Evaluator"
PROTOCOL = "Protocol of whole motions (tables 1 and 3)"

TableNumber = Annotated[str | None, typer.Option(help="Table to build, by its number in the paper.")]
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
        help="Exit with 0 although samples that cannot be read, or hold NaN, were left out.",
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
Evaluators = Annotated[
    str | None,
    typer.Option(
        "--evaluator",
        "--features",
        help="Feature sets: kinematic,native,guo; all there are. Of actions: linear, humanact12, uestc, cmu-mocap.",
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
MostMotions = Annotated[
    int, typer.Option(min=2, help="Most motions that a model generates.", rich_help_panel=EVALUATED)
]
ProtocolName = Annotated[
    str,
    typer.Option(
        help="Of whole motions: native, t2m, mdm, mld, t2m-gpt, momask; of actions: a2m, actor, mdm.",
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
        help="How often a model generates the whole set; 20 as published protocols do.",
        rich_help_panel=EVALUATED,
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Everything random follows from it.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
