"""`motionkit generate`: motions from texts, actions or nothing, at any framerate or at arbitrary instants."""

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motionkit.console import print_json, progress, stderr, stdout
from motionkit.core.progress import task
from motionkit.errors import UsageError
from motionkit.settings import default_path
from motionkit.timegrid import parse_fps
from nerm.commands import generate_options as options

if TYPE_CHECKING:
    from motionkit.generation import GenerativeModel
    from nerm.generation.folder import GeneratedFolder
    from nerm.generation.plan import GenerationPlan


def generate(
    texts: options.Texts = None,
    action: options.Actions = None,
    unconditional: options.Unconditional = False,
    prompts: options.PromptsFile = None,
    fps: options.Framerate = None,
    seconds: options.Seconds = None,
    join: options.Join = False,
    overlap: options.Overlap = 0.5,
    times: options.Times = None,
    count: options.Count = 1,
    out: options.OutFolder = Path("generated"),
    file_format: options.FileFormat = "npz",
    guidance: options.Guidance = None,
    sampler: options.Sampler = None,
    sampling_steps: options.SamplingSteps = None,
    seed: options.Seed = 0,
    resume: options.Resume = False,
    overwrite: options.Overwrite = False,
    model: options.ModelName = None,
    run: options.RunName = "nano",
    runs: options.RunsFolder = None,
    as_json: options.AsJson = False,
) -> None:
    """Generate motions from texts, actions or nothing: any framerate, or poses at arbitrary instants."""
    from motionkit.generation import SamplingOptions
    from nerm.generation.plan import make_plan, parse_times
    from nerm.generation.prompts import wanted_prompts

    if resume and overwrite:
        raise UsageError("--resume and --overwrite exclude each other")
    wanted = wanted_prompts(prompts, texts or [], action or [], unconditional, seconds)
    if times is not None and fps is not None:
        raise UsageError("--times and --fps exclude each other")
    rate = None if fps is None else _read_fps(fps)
    sampling = SamplingOptions(guidance, sampler, sampling_steps)
    instants = parse_times(times)
    plan = make_plan(wanted, count, instants, rate, file_format, seed, sampling, join=join, overlap_seconds=overlap)

    from motionkit.generation import load_model, model_of
    from nerm.generation.folder import begin_folder, replace_folder, resume_folder

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
    from motionkit.generation import DescribesMotions
    from nerm.generation.files import describe_sample

    report: dict[str, Any] = {"already_there": folder.num_done, "motions": []}
    plan.output.begin(folder.path, plan.fps)
    with progress() as show, task(show, "generate", len(plan.motions), done=folder.num_done) as work:
        for field, sample in plan.samples(model, folder.num_done):
            files = plan.output.files(sample.name)
            plan.output.write(folder.path / files[0], sample)
            folder.add(sample)
            work.advance()
            if not as_json:
                stdout.print(str(folder.path / files[0]), markup=False)
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
            markup=False,
        )


def say_joined(plan: "GenerationPlan", model: "GenerativeModel") -> None:
    """Say on stderr where motions are made in pieces, of which none knows the others."""
    joined = plan.num_joined(model)
    if joined:
        stderr.print(
            f"motionkit: {joined:,} of {len(plan.motions):,} motions are joined from several of up to "
            f"{model.max_duration_seconds:g} s, the longest that the model makes at once; each is laid over the last "
            f"{plan.overlap_seconds:g} s of the one before, of which it knows nothing",
            markup=False,
        )


def _read_fps(text: str) -> Fraction:
    try:
        return parse_fps(text)
    except ValueError as error:
        raise UsageError(f"--fps {text}: {error}") from None
