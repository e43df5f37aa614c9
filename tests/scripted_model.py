"""A generative model whose motions are a function of time: what tables ask of a model, without one that was trained."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motionkit.generation import GenerationRequest, SamplingOptions
from motionkit.motionfield import Poses
from motionkit.skeleton import SMPL22, Skeleton

PosesAt = Callable[[np.ndarray], np.ndarray]
"""Joint positions [times, 22, 3] in metres at instants in seconds."""
Script = Callable[[GenerationRequest, tuple[int, int]], PosesAt]
"""The motion that answers a request; the pair of numbers is what a motion's chance comes from: seed and number."""


@dataclass(frozen=True, eq=False)
class ScriptedField:
    """A motion field of 22 joints."""

    poses_at: PosesAt
    end_seconds: float
    start_seconds: float = 0.0
    skeleton: Skeleton = SMPL22

    def query(self, times_seconds: np.ndarray) -> Poses:
        return Poses(self.poses_at(times_seconds))


class ScriptedModel:
    """Answers every request by its script, and counts them in `asked`."""

    name = "NeRM"
    skeleton: Skeleton = SMPL22
    max_training_fps = Fraction(120)

    def __init__(self, script: Script, max_duration_seconds: float = 10.0) -> None:
        self.script, self.max_duration_seconds = script, max_duration_seconds
        self.asked = 0

    def generate(
        self,
        requests: Sequence[GenerationRequest],
        *,
        seed: int,
        sampling: SamplingOptions = SamplingOptions(),
        first: int = 0,
    ) -> list[ScriptedField]:
        self.asked += len(requests)
        fields = []
        for number, request in enumerate(requests, start=first):
            assert request.duration_seconds is not None and request.duration_seconds <= self.max_duration_seconds
            fields.append(ScriptedField(self.script(request, (seed, number)), request.duration_seconds))
        return fields
