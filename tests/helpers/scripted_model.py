"""A generative model whose motions are a function of time: what tables ask of a model, without one that was trained."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.fields.motion_field import Poses
from motionkit.generate.models import GenerationRequest, SamplingOptions
from motionkit.training.run import Loader

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

    def text_encoder(self) -> None:
        return None

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


STAGES = ("field", "denoiser")


def trained_run(run: Path) -> Path:
    """A run that holds the stages of scripted models, as far as anybody looks."""
    for stage in STAGES:
        (run / stage).mkdir(parents=True)
        (run / stage / "model.safetensors").write_text(f"{run.name} {stage}")
    return run


def install_models(monkeypatch: pytest.MonkeyPatch, *scripted: Callable[[Path], ScriptedModel]) -> None:
    """Let these be the installed models: functions of a run."""
    loaders = {
        f"model-{number}": Loader("NeRM", STAGES, load, fixed_fps_setting="field.clips.fixed_fps")
        for number, load in enumerate(scripted)
    }
    for module in ("eval.tables.systems", "eval.tables.nerm.table1"):
        monkeypatch.setattr(f"{module}.installed_models", lambda: loaders)
