"""`motionkit generate`: motions from texts, actions or nothing, at any framerate or at arbitrary instants."""

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.core.errors import UsageError
from motionkit.core.progress import task
from motionkit.core.settings import default_path
from motionkit.core.timegrid import parse_fps

FORMATS = "bvh, joints-npy, npz, csv, gltf, humanml3d"

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


if TYPE_CHECKING:
    from motionkit.generate.folder import GeneratedFolder
    from motionkit.generate.models import GenerativeModel
    from motionkit.generate.plan import GenerationPlan


def generate(
    texts: Texts = None,
    action: Actions = None,
    unconditional: Unconditional = False,
    prompts: PromptsFile = None,
    fps: Framerate = None,
    seconds: Seconds = None,
    join: Join = False,
    overlap: Overlap = 0.5,
    times: Times = None,
    count: Count = 1,
    out: OutFolder = Path("generated"),
    file_format: FileFormat = "npz",
    guidance: Guidance = None,
    sampler: Sampler = None,
    sampling_steps: SamplingSteps = None,
    seed: Seed = 0,
    resume: Resume = False,
    overwrite: Overwrite = False,
    model: ModelName = None,
    run: RunName = "nano",
    runs: RunsFolder = None,
    as_json: AsJson = False,
) -> None:
    """Generate motions from texts, actions or nothing: any framerate, or poses at arbitrary instants."""
    from motionkit.generate.models import SamplingOptions
    from motionkit.generate.plan import make_plan, parse_times
    from motionkit.generate.prompts import wanted_prompts

    if resume and overwrite:
        raise UsageError("--resume and --overwrite exclude each other")
    wanted = wanted_prompts(prompts, texts or [], action or [], unconditional, seconds)
    if times is not None and fps is not None:
        raise UsageError("--times and --fps exclude each other")
    rate = None if fps is None else _read_fps(fps)
    sampling = SamplingOptions(guidance, sampler, sampling_steps)
    instants = parse_times(times)
    plan = make_plan(wanted, count, instants, rate, file_format, seed, sampling, join=join, overlap_seconds=overlap)

    from motionkit.generate.folder import begin_folder, replace_folder, resume_folder
    from motionkit.generate.models import load_model, model_of

    place = (runs or default_path("runs")) / run
    loaded = load_model(model or model_of(place), place)
    plan = plan.for_model(loaded)
    warn_above_training(loaded, plan.fps)
    say_joined(plan, loaded)
    opening = resume_folder if resume else replace_folder if overwrite else begin_folder
    with opening(out, plan.manifest(loaded, place)) as folder:
        report = _write_all(plan, loaded, folder, as_json)
    if as_json:
        print_json({"model": loaded.name, "run": run, "seed": seed, "folder": str(out), **report})


def _write_all(
    plan: "GenerationPlan", model: "GenerativeModel", folder: "GeneratedFolder", as_json: bool
) -> dict[str, Any]:
    """Generate and write what is not there yet; names each file on stdout, or returns all of them for JSON."""
    from motionkit.generate.files import describe_sample
    from motionkit.generate.models import DescribesMotions

    report: dict[str, Any] = {"already_there": folder.num_done, "motions": []}
    plan.output.begin(folder.path, plan.fps)
    with progress() as show, task(show, "generate", len(plan.motions), done=folder.num_done) as work:
        for field, sample in plan.samples(model, folder.num_done):
            files = plan.output.files(sample.name)
            plan.output.write(folder.path / files[0], sample)
            folder.add(sample)
            work.advance()
            if not as_json:
                stdout.print(str(folder.path / files[0]))
                continue
            if not report["motions"] and isinstance(model, DescribesMotions):
                report |= {f"{name}_of_first": value for name, value in model.describe(field).items()}
            report["motions"].append(describe_sample(sample, str(folder.path / files[0])))
    if folder.num_done and not as_json:
        stderr.print(f"motionkit: {folder.num_done:,} of {len(plan.motions):,} motions were there already")
    return report


def warn_above_training(model: "GenerativeModel", fps: Fraction) -> None:
    """Say on stderr where a framerate is above the highest of the training data (the paper's limitation, B.3)."""
    if fps > model.max_training_fps:
        stderr.print(
            f"motionkit: warning: {float(fps):g} fps is above the {float(model.max_training_fps):g} fps of the model's "
            "fastest training data; detail beyond that is interpolated, not learned",
        )


def say_joined(plan: "GenerationPlan", model: "GenerativeModel") -> None:
    """Say on stderr where motions are made in pieces, of which none knows the others."""
    joined = plan.num_joined(model)
    if joined:
        stderr.print(
            f"motionkit: {joined:,} of {len(plan.motions):,} motions are joined from several of up to "
            f"{model.max_duration_seconds:g} s, the longest that the model makes at once; each is laid over the last "
            f"{plan.overlap_seconds:g} s of the one before, of which it knows nothing",
        )


def _read_fps(text: str) -> Fraction:
    try:
        return parse_fps(text)
    except ValueError as error:
        raise UsageError(f"--fps {text}: {error}") from None
