"""One `motionkit generate` call as a value: what is wanted, in which order, at which instants, as which files."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.errors import UsageError
from motionkit.generation import ChecksRequests, GenerationRequest, GenerativeModel, SamplingOptions
from motionkit.motionfield import MotionField
from motionkit.timegrid import format_fps
from motionkit.training.run import versions
from nerm.encoder_folder import file_sha256
from nerm.generated_files import OUTPUTS, GeneratedSample, OutputFormat, motion_name, sample_field
from nerm.generated_folder import FORMAT
from nerm.prompts import Prompt

# Motions whose latents are drawn in one batch; their poses are decoded and written one by one.
MOTIONS_AT_ONCE = 64


@dataclass(frozen=True)
class GenerationPlan:
    """`count` motions of each prompt, at `times` or at `asked_fps` (None: the format's or the model's own)."""

    prompts: tuple[Prompt, ...]
    count: int
    times: tuple[float, ...]
    asked_fps: Fraction | None
    output: OutputFormat
    seed: int
    sampling: SamplingOptions
    max_training_fps: Fraction | None = None

    @property
    def requests(self) -> list[GenerationRequest]:
        """One per motion: motion i is of prompt i // count."""
        return [prompt.request for prompt in self.prompts for _ in range(self.count)]

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
        for prompt in self.prompts:
            try:
                if isinstance(model, ChecksRequests):
                    model.check(prompt.request, self.sampling)
            except UsageError as error:
                raise UsageError(f"{prompt.where}: {error}" if prompt.where else str(error)) from None
        return replace(self, max_training_fps=model.max_training_fps)

    def manifest(self, model: GenerativeModel, run: Path) -> dict[str, Any]:
        """What was asked for, of which weights: the same manifest gives the same motions."""
        requests = [prompt.request for prompt in self.prompts]
        return {
            "format": FORMAT,
            "version": 1,
            "model": model.name,
            "weights_sha256": {path.parent.name: file_sha256(path) for path in sorted(run.glob("*/model.safetensors"))},
            "seed": self.seed,
            "sampling": asdict(self.sampling),
            "file_format": self.output.name,
            "fps": None if self.times else format_fps(self.fps),
            "times_seconds": list(self.times) or None,
            "max_training_fps": format_fps(model.max_training_fps),
            "count": self.count,
            "conditions": [
                {"text": request.text, "action": request.action, "seconds": request.duration_seconds}
                for request in requests
            ],
            "versions": versions(),
        }

    def samples(self, model: GenerativeModel, num_done: int = 0) -> Iterator[tuple[MotionField, GeneratedSample]]:
        """Fields and their poses from motion `num_done` on, one at a time in memory.

        Batches begin at the same motions wherever a call goes on, so a resumed one writes the same numbers.
        """
        requests = self.requests
        times = np.array(self.times, dtype=np.float64) if self.times else None
        for start in range(num_done - num_done % MOTIONS_AT_ONCE, len(requests), MOTIONS_AT_ONCE):
            batch = requests[start : start + MOTIONS_AT_ONCE]
            fields = model.generate(batch, seed=self.seed, sampling=self.sampling, first=start)
            for index, (request, field) in enumerate(zip(batch, fields, strict=True), start=start):
                if index >= num_done:
                    yield field, sample_field(field, motion_name(index, request), request, self.fps, times)


def make_plan(
    prompts: Sequence[Prompt],
    count: int,
    times: tuple[float, ...],
    fps: Fraction | None,
    file_format: str,
    seed: int,
    sampling: SamplingOptions,
) -> GenerationPlan:
    """A plan; raises `UsageError` for an unknown format, or instants that it or a prompt's length does not allow."""
    if file_format not in OUTPUTS:
        raise UsageError(f"--format is one of {', '.join(OUTPUTS)}, not {file_format!r}")
    output = OUTPUTS[file_format]
    if times and not output.any_instants:
        raise UsageError(f"a {file_format} file has one framerate: --times goes with --format npz")
    for prompt in prompts if times else ():
        length = prompt.request.duration_seconds
        place = f"{prompt.where}: " if prompt.where else ""
        if length is None:
            raise UsageError(f"{place}--times needs --seconds: they are instants of a motion of a given length")
        outside = [instant for instant in times if not 0 <= instant <= length]
        if outside:
            raise UsageError(f"{place}--times: {outside[0]:g} s lies outside the motion's 0 … {length:g} s")
    return GenerationPlan(tuple(prompts), count, times, fps, output, seed, sampling)


def parse_times(times: str | None) -> tuple[float, ...]:
    """The instants of `--times`, empty without it; raises `UsageError` for what is no list of seconds."""
    if times is None:
        return ()
    try:
        return tuple(float(part) for part in times.split(","))
    except ValueError:
        raise UsageError(f"--times takes seconds separated by commas (0.5,1.25), not {times!r}") from None
