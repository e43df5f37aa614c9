"""`motionkit generate`: motions from texts, actions or nothing, at any framerate or at arbitrary instants."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.console import print_json, stderr, stdout
from motionkit.errors import UsageError
from motionkit.settings import default_path
from motionkit.timegrid import parse_fps

if TYPE_CHECKING:
    from motionkit.generation import GenerationRequest, GenerativeModel, SamplingOptions


def generate(
    texts: Annotated[list[str] | None, typer.Argument(help="What the person does; several make a batch.")] = None,
    action: Annotated[list[str] | None, typer.Option(help="An action the model knows; may be repeated.")] = None,
    unconditional: Annotated[bool, typer.Option("--unconditional", help="Motions of no stated kind.")] = False,
    fps: Annotated[
        str | None, typer.Option(help="Any framerate: 144, 23.976, 24000/1001 [the highest trained].")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="Length; drawn from the training data's by default.")] = None,
    times: Annotated[
        str | None, typer.Option(metavar="S,S,…", help="Poses at these seconds only, instead of --fps.")
    ] = None,
    count: Annotated[int, typer.Option("-n", "--count", min=1, help="Motions per text or action.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder for the files.")] = Path("generated"),
    file_format: Annotated[str, typer.Option("--format", help="npz or bvh.")] = "npz",
    guidance: Annotated[float | None, typer.Option(help="Guidance scale r (Eq. 6) [the recipe's].")] = None,
    sampler: Annotated[str | None, typer.Option(help="ddim or ddpm [the recipe's].")] = None,
    sampling_steps: Annotated[
        int | None, typer.Option(min=1, help="Diffusion steps visited [the recipe's; ddpm likes more].")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same motions at every framerate.")] = 0,
    model: Annotated[str, typer.Option(help="Installed model.")] = "nerm",
    run: Annotated[str, typer.Option(help="Name of the run.")] = "nano",
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Generate motions from texts, actions or nothing: any framerate, or poses at arbitrary instants."""
    requests = build_requests(texts or [], action or [], unconditional, seconds, count)
    instants = parse_times(times, seconds, fps)
    if file_format not in ("npz", "bvh"):
        raise UsageError(f"--format is npz or bvh, not {file_format!r}")
    if file_format == "bvh" and instants:
        raise UsageError("a BVH file has one framerate: --times goes with --format npz")
    wanted = None if fps is None else _read_fps(fps)

    from motionkit.generation import SamplingOptions, load_model

    loaded = load_model(model, (runs or default_path("runs")) / run)
    rate = wanted or loaded.max_training_fps
    warn_above_training(loaded, rate)
    sampling = SamplingOptions(guidance, sampler, sampling_steps)
    written = _write_all(loaded, requests, rate, instants, out, file_format, seed, sampling)
    if as_json:
        print_json({"model": loaded.name, "seed": seed, "motions": written})
        return
    for motion in written:
        stdout.print(motion["file"], markup=False)


def build_requests(
    texts: Sequence[str], actions: Sequence[str], unconditional: bool, seconds: float | None, count: int
) -> "list[GenerationRequest]":
    """`count` requests per text or action; raises `UsageError` unless exactly one kind of condition is asked for."""
    from motionkit.generation import GenerationRequest

    if sum((bool(texts), bool(actions), unconditional)) != 1:
        raise UsageError("give texts, or --action, or --unconditional: exactly one of the three")
    if any(not text.strip() for text in (*texts, *actions)):
        raise UsageError("a text or action is empty; --unconditional asks for motions of no stated kind")
    kinds = [GenerationRequest(seconds, text=text) for text in texts]
    kinds += [GenerationRequest(seconds, action=action) for action in actions]
    kinds += [GenerationRequest(seconds)] if unconditional else []
    return [request for request in kinds for _ in range(count)]


def parse_times(times: str | None, seconds: float | None, fps: str | None) -> tuple[float, ...]:
    """The instants of `--times`, empty without it; raises `UsageError` for what cannot be read or makes no sense."""
    if times is None:
        return ()
    if fps is not None:
        raise UsageError("--times and --fps exclude each other")
    if seconds is None:
        raise UsageError("--times needs --seconds: they are instants of a motion of a given length")
    try:
        instants = tuple(float(part) for part in times.split(","))
    except ValueError:
        raise UsageError(f"--times takes seconds separated by commas (0.5,1.25), not {times!r}") from None
    outside = [instant for instant in instants if not 0 <= instant <= seconds]
    if outside:
        raise UsageError(f"--times: {outside[0]:g} s lies outside the motion's 0 … {seconds:g} s")
    return instants


def warn_above_training(model: "GenerativeModel", fps: Fraction) -> None:
    """Say on stderr where a framerate is above the highest of the training data (the paper's limitation, B.3)."""
    if fps > model.max_training_fps:
        stderr.print(
            f"motionkit: warning: {float(fps):g} fps is above the {float(model.max_training_fps):g} fps of the model's "
            "fastest training data; detail beyond that is interpolated, not learned",
            markup=False,
        )


def _read_fps(text: str) -> Fraction:
    try:
        return parse_fps(text)
    except ValueError as error:
        raise UsageError(f"--fps {text}: {error}") from None


def _write_all(
    model: "GenerativeModel",
    requests: "Sequence[GenerationRequest]",
    fps: Fraction,
    instants: tuple[float, ...],
    out: Path,
    file_format: str,
    seed: int,
    sampling: "SamplingOptions",
) -> list[dict[str, Any]]:
    """Generate and write one file per request; returns what was written, for people and for JSON."""
    import numpy as np

    from nerm.generated_files import file_name, sample_field, write_bvh_file, write_npz_file

    fields = model.generate(requests, seed=seed, sampling=sampling)
    out.mkdir(parents=True, exist_ok=True)
    written = []
    for index, (request, field) in enumerate(zip(requests, fields, strict=True)):
        given_times = np.array(instants, dtype=np.float64) if instants else None
        sample = sample_field(field, request, fps, given_times)
        path = out / f"{file_name(index, request)}.{file_format}"
        (write_npz_file if file_format == "npz" else write_bvh_file)(path, sample)
        written.append({"file": str(path), **sample.description()})
    return written
