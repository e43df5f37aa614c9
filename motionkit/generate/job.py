"""The work of a `motionkit generate` call: generate the motions of a request and write them into a folder."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.framerate import format_fps
from motionkit.fields.detail.detailed import detailed
from motionkit.fields.detail.model import Detail
from motionkit.fields.motion_field import MotionField
from motionkit.generate.files import OutputFormat
from motionkit.generate.folder import CONSTRAINTS, FORMAT, JOINS, GeneratedFolder
from motionkit.generate.long_motions import check_script, generate_scripts, is_joined, supports_continuation
from motionkit.generate.models import GenerationRequest, GenerativeModel, SamplingOptions
from motionkit.generate.request import MotionsRequest
from motionkit.generate.samples import GeneratedSample, motion_name, sample_field, standing
from motionkit.training.run import versions, weights_sha256


@dataclass(frozen=True)
class Job:
    """A request, a model of a run, and an output format; motions are planted unless `plant` is false.

    With `detail` motions get captures' motion above 10 Hz, from the same seed (docs/detail.md).

    Raises `UsageError`, with the prompt's file and line, for unsupported requests, before anything is generated.
    """

    request: MotionsRequest
    model: GenerativeModel
    run: Path
    output: OutputFormat
    seed: int
    sampling: SamplingOptions
    plant: bool = True
    detail: Detail | None = None

    def __post_init__(self) -> None:
        for prompts in self.request.scripts:
            try:
                check_script(self.model, self.request.script_of(prompts), self.sampling, self.request.overlap_seconds)
            except UsageError as error:
                where = prompts[0].where if len(prompts) == 1 else ""
                raise UsageError(f"{where}: {error}" if where else str(error)) from None

    @property
    def fps(self) -> Fraction:
        """Framerate of the files."""
        return self.request.fps or self.output.fps or self.model.max_training_fps

    @property
    def num_joined(self) -> int:
        """How many motions are joined from several."""
        return sum(is_joined(script, self.model.max_duration_seconds) for script in self.request.motions)

    def manifest(self) -> dict[str, Any]:
        """The request and the weights' identity: the same manifest gives the same motions."""
        request = self.request
        return {
            "format": FORMAT,
            "version": 1,
            "model": self.model.name,
            "weights_sha256": weights_sha256(self.run),
            "seed": self.seed,
            "sampling": asdict(self.sampling),
            "planted": self.plant,
            "with_detail": self.detail is not None,
            "file_format": self.output.name,
            "fps": None if request.times else format_fps(self.fps),
            "times_seconds": list(request.times) or None,
            "max_training_fps": format_fps(self.model.max_training_fps),
            "count": request.count,
            "conditions": [_described(prompt.request) for prompts in request.scripts for prompt in prompts],
            "joined": any(len(script) > 1 for script in request.scripts),
            "overlap_seconds": request.overlap_seconds if self.num_joined else None,
            JOINS: None if not self.num_joined else "in phase" if supports_continuation(self.model) else "cross-faded",
            CONSTRAINTS: [each.plain() for each in request.constraints],
            "versions": versions(),
        }

    def samples(self, num_done: int = 0) -> Iterator[tuple[MotionField, GeneratedSample]]:
        """Fields and their poses from motion `num_done` on, one at a time in memory.

        Batches are aligned whatever the first motion, so a resumed call writes the same numbers.
        """
        motions, times = self.request.motions, self.request.times
        fields = generate_scripts(
            *(self.model, motions),
            seed=self.seed,
            first=num_done,
            sampling=self.sampling,
            overlap_seconds=self.request.overlap_seconds,
        )
        for index, field in enumerate(fields, start=num_done):
            name = motion_name(index, motions[index])
            seconds = np.array(times, dtype=np.float64) if times else None
            shown = standing(field, motions[index]) if self.plant else field
            if self.detail is not None:
                shown = detailed(shown, self.detail, seed=self.seed, number=index)
            yield field, sample_field(shown, name, motions[index], self.fps, seconds)

    def write(self, folder: GeneratedFolder) -> Iterator[tuple[MotionField, GeneratedSample, Path]]:
        """Generate and write missing motions one by one: the field, its poses, and its file."""
        self.output.begin(folder.path, self.fps)
        for field, sample in self.samples(folder.num_done):
            path = folder.path / self.output.files(sample.name)[0]
            self.output.write(path, sample)
            folder.add(sample)
            yield field, sample, path


def _described(request: GenerationRequest) -> dict[str, Any]:
    return {"text": request.text, "action": request.action, "seconds": request.duration_seconds}
