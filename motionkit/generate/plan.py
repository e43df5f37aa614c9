"""One `motionkit generate` call as a value: what is wanted, in which order, at which instants, as which files."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.timegrid import format_fps
from motionkit.fields.motion_field import MotionField
from motionkit.generate.files import OutputFormat, output_formats
from motionkit.generate.folder import FORMAT
from motionkit.generate.long_motions import OVERLAP_SECONDS, Script, check_script, generate_scripts, is_joined
from motionkit.generate.models import GenerationRequest, GenerativeModel, SamplingOptions
from motionkit.generate.prompts import Prompt
from motionkit.generate.samples import GeneratedSample, motion_name, sample_field
from motionkit.training.run import versions, weights_sha256


@dataclass(frozen=True)
class GenerationPlan:
    """`count` motions of each script, at `times` or at `asked_fps` (None: the format's or the model's own).

    A script is what one motion shows: a prompt, or with `--join` all of them in a row. `overlap_seconds` is for motions
    that are joined from several.
    """

    scripts: tuple[tuple[Prompt, ...], ...]
    count: int
    times: tuple[float, ...]
    asked_fps: Fraction | None
    output: OutputFormat
    seed: int
    sampling: SamplingOptions
    overlap_seconds: float = OVERLAP_SECONDS
    max_training_fps: Fraction | None = None

    @property
    def motions(self) -> list[Script]:
        """What each motion shows: motion i is of script i // count."""
        return [_requests(prompts) for prompts in self.scripts for _ in range(self.count)]

    @property
    def fps(self) -> Fraction:
        """Framerate of the files."""
        fps = self.asked_fps or self.output.fps or self.max_training_fps
        assert fps is not None
        return fps

    def for_model(self, model: GenerativeModel) -> "GenerationPlan":
        """The plan with the model's own framerate.

        Raises `UsageError`, with the prompt's file and line, for what the model cannot do: before anything is made.
        """
        for prompts in self.scripts:
            try:
                check_script(model, _requests(prompts), self.sampling, self.overlap_seconds)
            except UsageError as error:
                where = prompts[0].where if len(prompts) == 1 else ""
                raise UsageError(f"{where}: {error}" if where else str(error)) from None
        return replace(self, max_training_fps=model.max_training_fps)

    def num_joined(self, model: GenerativeModel) -> int:
        """How many motions are joined from several."""
        return sum(is_joined(script, model.max_duration_seconds) for script in self.motions)

    def manifest(self, model: GenerativeModel, run: Path) -> dict[str, Any]:
        """What was asked for, of which weights: the same manifest gives the same motions."""
        scripts = [[_described(prompt.request) for prompt in prompts] for prompts in self.scripts]
        return {
            "format": FORMAT,
            "version": 1,
            "model": model.name,
            "weights_sha256": weights_sha256(run),
            "seed": self.seed,
            "sampling": asdict(self.sampling),
            "file_format": self.output.name,
            "fps": None if self.times else format_fps(self.fps),
            "times_seconds": list(self.times) or None,
            "max_training_fps": format_fps(model.max_training_fps),
            "count": self.count,
            "conditions": [described for script in scripts for described in script],
            "joined": any(len(script) > 1 for script in scripts),
            "overlap_seconds": self.overlap_seconds if self.num_joined(model) else None,
            "versions": versions(),
        }

    def samples(self, model: GenerativeModel, num_done: int = 0) -> Iterator[tuple[MotionField, GeneratedSample]]:
        """Fields and their poses from motion `num_done` on, one at a time in memory.

        Batches begin at the same motions wherever a call goes on, so a resumed one writes the same numbers.
        """
        motions = self.motions
        times = np.array(self.times, dtype=np.float64) if self.times else None
        fields = generate_scripts(
            *(model, motions),
            seed=self.seed,
            first=num_done,
            sampling=self.sampling,
            overlap_seconds=self.overlap_seconds,
        )
        for index, field in enumerate(fields, start=num_done):
            name = motion_name(index, motions[index])
            yield field, sample_field(field, name, motions[index], self.fps, times)


def _requests(prompts: Sequence[Prompt]) -> Script:
    return tuple(prompt.request for prompt in prompts)


def _described(request: GenerationRequest) -> dict[str, Any]:
    return {"text": request.text, "action": request.action, "seconds": request.duration_seconds}


def make_plan(
    prompts: Sequence[Prompt],
    count: int,
    times: tuple[float, ...],
    fps: Fraction | None,
    file_format: str,
    seed: int,
    sampling: SamplingOptions,
    *,
    join: bool = False,
    overlap_seconds: float = OVERLAP_SECONDS,
) -> GenerationPlan:
    """A plan of a motion for each prompt, or of one for all of them.

    Raises `UsageError` for an unknown format, for instants that it or a motion's length does not allow, and for prompts
    without a length that are to be joined.
    """
    output = output_formats().get(file_format)
    if output is None:
        raise UsageError(f"--format is one of {', '.join(output_formats())}, not {file_format!r}")
    if times and not output.any_instants:
        raise UsageError(f"a {file_format} file has one framerate: --times goes with --format npz")
    for prompt in prompts if join else ():
        if prompt.request.duration_seconds is None:
            place = f"{prompt.where}: " if prompt.where else ""
            raise UsageError(f"{place}--join needs to know how long each part lasts: --seconds, or in --prompts")
    scripts = (tuple(prompts),) if join else tuple((prompt,) for prompt in prompts)
    for script in scripts if times else ():
        lengths = [prompt.request.duration_seconds for prompt in script]
        length = None if None in lengths else sum(seconds for seconds in lengths if seconds is not None)
        place = f"{script[0].where}: " if len(script) == 1 and script[0].where else ""
        if length is None:
            raise UsageError(f"{place}--times needs --seconds: they are instants of a motion of a given length")
        outside = [instant for instant in times if not 0 <= instant <= length]
        if outside:
            raise UsageError(f"{place}--times: {outside[0]:g} s lies outside the motion's 0 … {length:g} s")
    return GenerationPlan(scripts, count, times, fps, output, seed, sampling, overlap_seconds)


def parse_times(times: str | None) -> tuple[float, ...]:
    """The instants of `--times`, empty without it; raises `UsageError` for what is no list of seconds."""
    if times is None:
        return ()
    try:
        return tuple(float(part) for part in times.split(","))
    except ValueError:
        raise UsageError(f"--times takes seconds separated by commas (0.5,1.25), not {times!r}") from None
