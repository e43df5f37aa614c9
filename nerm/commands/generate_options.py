"""The options of `motionkit generate`: their types and what the command line says of them."""

from pathlib import Path
from typing import Annotated

import typer

FORMATS = "npz, bvh, gltf, humanml3d"

Texts = Annotated[list[str] | None, typer.Argument(help="What the person does; several make a batch.")]
Actions = Annotated[list[str] | None, typer.Option(help="An action the model knows; may be repeated.")]
Unconditional = Annotated[bool, typer.Option("--unconditional", help="Motions of no stated kind.")]
PromptsFile = Annotated[
    Path | None, typer.Option(help="A .txt with a text a line, or a .csv or .jsonl of text, action, seconds.")
]
Framerate = Annotated[
    str | None,
    typer.Option(help="Any framerate: 144, 23.976, 24000/1001 (else the highest trained; 20 for humanml3d)."),
]
Seconds = Annotated[
    float | None, typer.Option(help="Length, of any motion; drawn from the training data's by default.")
]
Join = Annotated[bool, typer.Option("--join", help="One motion of all texts or actions in a row, --seconds of each.")]
Overlap = Annotated[
    float, typer.Option(help="Seconds by which the parts of a joined or long motion go over into one another.")
]
Times = Annotated[str | None, typer.Option(metavar="S,S,…", help="Poses at these seconds only, instead of --fps.")]
Count = Annotated[int, typer.Option("-n", "--count", min=1, help="Motions per text or action.")]
OutFolder = Annotated[Path, typer.Option(help="New or empty folder for the files.")]
FileFormat = Annotated[str, typer.Option("--format", help=f"{FORMATS}.")]
Guidance = Annotated[float | None, typer.Option(help="Guidance scale r of Eq. 6 (else the recipe's).")]
Sampler = Annotated[str | None, typer.Option(help="ddim or ddpm (else the recipe's).")]
SamplingSteps = Annotated[
    int | None, typer.Option(min=1, help="Diffusion steps visited (else the recipe's; ddpm likes more).")
]
Seed = Annotated[int, typer.Option(min=0, help="The same seed gives the same motions at every framerate.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with a call that was stopped.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a former call's files.")]
ModelName = Annotated[str | None, typer.Option(help="Installed model.", show_default="the one that the run holds")]
RunName = Annotated[str, typer.Option(help="Name of the run.")]
RunsFolder = Annotated[Path | None, typer.Option(help="Folder of all runs.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")]
