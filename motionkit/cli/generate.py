"""`motionkit generate`: motions from texts, actions or nothing, at any framerate or at arbitrary instants."""

from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli import console
from motionkit.core.errors import UsageError, counted
from motionkit.core.files import is_store
from motionkit.core.progress import task

FORMATS = "bvh, amass, joints-npy, npz, csv, robot-csv, gltf"


def generate(
    texts: Annotated[list[str] | None, typer.Argument(help="What the person does; give several for a batch.")] = None,
    action: Annotated[list[str] | None, typer.Option(help="An action the model knows; may be repeated.")] = None,
    unconditional: Annotated[bool, typer.Option("--unconditional", help="Motions without a text or action.")] = False,
    prompts: Annotated[
        Path | None, typer.Option(help="A .txt with a text per line, or a .csv of text, action, seconds.")
    ] = None,
    fps: Annotated[
        str | None, typer.Option(help="Any framerate: 144, 23.976, 24000/1001 (else the highest trained).")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Length of each motion; drawn from the training data's by default.")
    ] = None,
    join: Annotated[
        bool, typer.Option("--join", help="One motion of all texts or actions in sequence, --seconds of each.")
    ] = False,
    times: Annotated[
        str | None, typer.Option(metavar="S,S,…", help="Poses at these seconds only, instead of --fps.")
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option(help="The body's path: a CSV of x, z in metres, optionally seconds and heading_degrees."),
    ] = None,
    pose: Annotated[
        list[str] | None,
        typer.Option(metavar="S=FILE[@S]", help="A pose at a time in seconds (2.0=clip.bvh@1.5); may be repeated."),
    ] = None,
    joint: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME@S[-S]=X,Y,Z", help="A joint at a place in metres: left_foot@1=0,0,1. May be repeated."
        ),
    ] = None,
    pose_placed: Annotated[
        bool,
        typer.Option(
            "--pose-placed", help="Poses keep the position and heading of their files, instead of any on the floor."
        ),
    ] = False,
    count: Annotated[int, typer.Option("-n", "--count", min=1, help="Motions per text or action.")] = 1,
    out: Annotated[Path, typer.Option(help="New or empty folder for the files.")] = Path("generated"),
    file_format: Annotated[str, typer.Option("--format", help=f"{FORMATS}.")] = "npz",
    guidance: Annotated[float | None, typer.Option(help="Guidance scale r of Eq. 6 (else the recipe's).")] = None,
    sampler: Annotated[str | None, typer.Option(help="ddim or ddpm (else the recipe's).")] = None,
    sampling_steps: Annotated[
        int | None, typer.Option(min=1, help="Diffusion steps visited (else the recipe's).")
    ] = None,
    plant: Annotated[
        bool, typer.Option("--plant/--no-plant", help="Make sliding feet stand, on bones of one length.")
    ] = True,
    detail: Annotated[
        bool, typer.Option("--detail", help="Add what captures hold above 10 Hz (docs/detail.md).")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same motions at every framerate.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Continue a stopped call.")] = False,
    overwrite: console.Overwrite = False,
    model: Annotated[
        str | None, typer.Option(help="Installed model.", show_default="the one that the run holds")
    ] = None,
    run: Annotated[
        str | None, typer.Option(help="Name of the run.", show_default="nano, else the shipped cmu-small")
    ] = None,
    runs: console.RunsFolder = None,
    as_json: console.AsJson = False,
) -> None:
    """Generate motions from texts, actions or nothing: any framerate, or poses at arbitrary instants.

    Example: motionkit generate --unconditional --seconds 4 --fps 120 -n 4 --out made --format bvh"""
    from motionkit.generate.models import SamplingOptions, load_model, model_of, warn_above_training
    from motionkit.generate.output import Job, locked_output, output_format
    from motionkit.generate.request import MotionsRequest, parse_constraints, parse_prompts, parse_times, read_path
    from motionkit.store import Store
    from motionkit.training.detail import load_detail
    from motionkit.training.run import RunFolder, find_run, loader_named
    from motionkit.training.text import unfamiliar_texts

    if resume and overwrite:
        raise UsageError("--resume and --overwrite exclude each other")
    if times and fps:
        raise UsageError("--times and --fps exclude each other")
    if detail and file_format == "bvh":
        raise UsageError("--detail is for measuring and training: it adds captures' jitter, and isn't written as BVH")
    table = None if path is None else read_path(path)
    if seconds is None and table is not None and table.seconds is not None:
        seconds = float(table.seconds[-1])
    chosen = parse_prompts(prompts, texts or [], action or [], unconditional, seconds)
    rate, instants = console.parse_rate(fps), parse_times(times)
    output = output_format(file_format, instants)
    constraints = parse_constraints(table, join, chosen, pose, joint, placed=pose_placed)
    request = MotionsRequest(tuple(chosen), count, instants, rate, join, constraints)

    place = find_run(run, runs)
    name = model or model_of(place)
    loaded = load_model(name, place)
    sampling, learnt = SamplingOptions(guidance, sampler, sampling_steps), load_detail(place) if detail else None
    job = Job(request, loaded, place, output, seed, sampling, plant, learnt)
    warn_above_training(loaded, job.fps)
    requests = [each for script in request.motions for each in script]
    given = list(dict.fromkeys(each.text for each in requests if each.text and not each.action))
    if given and (encoder := loaded.text_encoder()) is not None:
        trained_on = RunFolder(place).stage(loader_named("MODELS", name).stages[-1]).read_config()["store"]
        if trained_on and is_store(Path(trained_on)):
            for text, nearest in unfamiliar_texts(encoder, Store.open(trained_on), given).items():
                console.stderr.print(f"motionkit: nothing like {text!r} in training: nearest {nearest!r}")
    num_motions = len(request.motions)
    if job.num_joined:
        console.stderr.print(
            f"motionkit: {job.num_joined:,} of {counted(num_motions, 'motion')}: joined from several of up to "
            f"{loaded.max_duration_seconds:g} s, the longest that the model makes at once"
        )
    motions = []
    with locked_output(out, job.manifest(), resume=resume, overwrite=overwrite):
        num_complete = len(job.complete_in(out))
        with console.progress() as show, task(show, "generate", num_motions, done=num_complete) as work:
            for facts in job.write(out):
                work.advance()
                motions.append(facts)
                if not as_json:
                    console.stdout.print(facts["file"])
    if as_json:
        about = {"model": loaded.name, "run": place.name, "seed": seed, "folder": str(out)}
        console.print_json({**about, "already_there": num_complete, "motions": motions})
    elif num_complete:
        console.stderr.print(f"motionkit: {num_complete:,} of {counted(num_motions, 'motion')}: there already")
