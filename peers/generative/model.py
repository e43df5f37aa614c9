"""A trained generative peer as a `GenerativeModel`: frames at its own framerate, SLERP between them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import ceil
from pathlib import Path

import numpy as np
import torch

from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.interpolation import INTERPOLATORS, InterpolatedField
from motionkit.fields.motion_field import MotionField, Observation
from motionkit.generate.models import GenerationRequest, SamplingOptions
from motionkit.training.devices import resolve_device
from motionkit.training.diffusion.settings import DiffusionConfig
from motionkit.training.loop import step_generator
from motionkit.training.run import RunError, RunFolder
from motionkit.training.text import TextEncoder
from peers.generative.batches import NO_ACTION, Conditions, SampleBatch
from peers.generative.corpus import embedded, text_encoder_of
from peers.generative.peer import GenerativePeer
from peers.generative.training import Sampler, TrainedStage, load_stage

MOTIONS_PER_BATCH = 64


@dataclass(frozen=True, eq=False)
class PeerModel:
    """A `motionkit.generate.models.GenerativeModel`; `name` is that of its rows.

    `unconditional`: it takes no text and no action.
    """

    name: str
    trained: TrainedStage
    device: torch.device
    unconditional: bool = False

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of its pose vectors."""
        return self.trained.space.vectors.skeleton

    @property
    def max_training_fps(self) -> Fraction:
        """The one framerate that it was trained at."""
        return self.trained.space.fps

    @property
    def max_duration_seconds(self) -> float:
        """The longest motion that it was trained on."""
        return float(self.trained.config.motions.max_duration_seconds)

    @property
    def always_conditioned(self) -> bool:
        """Whether it learnt from no motion without its condition, but for those that have none."""
        return not (self.unconditional or self.trained.config.conditions.drop)

    @cached_property
    def text_encoder(self) -> TextEncoder:
        """The encoder it was trained with; raises `RunError` where its weights have changed."""
        encoder = text_encoder_of(self.trained.config.conditions)
        assert encoder is not None
        if encoder.fingerprint != self.trained.text_fingerprint:
            raise RunError(
                f"the text encoder {self.trained.config.conditions.text_encoder!r} is not the one that {self.name} was "
                f"trained with (fingerprint {encoder.fingerprint[:16]}, expected {self.trained.text_fingerprint[:16]})"
            )
        return encoder

    def check(self, request: GenerationRequest, sampling: SamplingOptions = SamplingOptions()) -> None:
        """Raise `UsageError` for a duration, text, action or sampling option that this model does not support."""
        self._diffusion(sampling)
        seconds = request.duration_seconds
        if seconds is not None and not 0 < seconds <= self.max_duration_seconds + 1e-9:
            raise UsageError(
                f"{self.name} generates more than 0 and up to {self.max_duration_seconds:g} s, not {seconds:g} s"
            )
        if self.unconditional and (request.text or request.action):
            raise UsageError(f"this {self.name} knows no texts and no actions: ask unconditionally")
        kind, known = self.trained.config.conditions.kind, self.trained.sizes.actions
        if request.text and not request.action and kind != "text":
            raise UsageError(
                f"this {self.name} was trained without texts: ask for an action, or unconditionally, or train another "
                "run with --set conditions.kind=text"
            )
        if request.action and not (request.text and kind == "text") and request.action not in known:
            raise UsageError(
                f"this {self.name} knows no action {request.action!r}; it knows {', '.join(known)}"
                if known
                else f"this {self.name} was trained without actions: ask for a text, or unconditionally, or train "
                "another run with --set conditions.kind=action"
            )

    def generate(
        self,
        requests: Sequence[GenerationRequest],
        *,
        seed: int,
        sampling: SamplingOptions = SamplingOptions(),
        first: int = 0,
    ) -> list[MotionField]:
        """One field per request, in order; field i depends on (seed, `first` + i) and request i alone, up to rounding.

        Raises `UsageError` as `check` does.
        """
        for request in requests:
            self.check(request, sampling)
        seconds = [self._seconds(request, seed, first + row) for row, request in enumerate(requests)]
        # A batch is padded to its longest motion: motions of similar length are batched together.
        rows = sorted(range(len(requests)), key=lambda row: seconds[row])
        made: dict[int, MotionField] = {}
        for start in range(0, len(rows), MOTIONS_PER_BATCH):
            some = rows[start : start + MOTIONS_PER_BATCH]
            generators = [step_generator(seed, "generate", first + row) for row in some]
            batch, durations = [requests[row] for row in some], [seconds[row] for row in some]
            made |= zip(some, self._generated(batch, durations, generators, self._diffusion(sampling)), strict=True)
        return [made[row] for row in range(len(requests))]

    def _generated(
        self,
        requests: Sequence[GenerationRequest],
        seconds: Sequence[float],
        generators: list[torch.Generator],
        diffusion: DiffusionConfig,
    ) -> list[MotionField]:
        fps, most = float(self.max_training_fps), self.trained.config.motions.max_frames + 1
        lengths = [min(ceil(each * fps - 1e-6) + 1, most) for each in seconds]
        conditions = self._conditions(requests)
        batch = SampleBatch(
            lengths=torch.tensor(lengths),
            conditions=conditions,
            unconditional=conditions.dropped(torch.ones(len(requests), dtype=torch.bool), self.trained.nothing),
            generators=generators,
            device=self.device,
        )
        network = self.trained.network
        assert isinstance(network, Sampler)
        with torch.inference_mode():
            rows = network.sample(batch, diffusion).to(self.device, torch.float32)
            vectors = (rows * self.trained.space.scale + self.trained.space.mean).cpu().numpy()
        if not np.isfinite(vectors).all():
            raise UsageError(f"sampling diverged: a guidance scale of {diffusion.guidance_scale:g} is too large")
        return [self._field(each[:length], own) for each, length, own in zip(vectors, lengths, seconds, strict=True)]

    def _field(self, vectors: Float32[np.ndarray, "frames numbers"], duration_seconds: float) -> MotionField:
        """Poses at the model's own framerate, interpolated by SLERP over the requested duration."""
        space = self.trained.space
        grid = TimeGrid(space.fps, len(vectors))
        seconds = grid.seconds()
        instants = space.vectors.instants(seconds)
        between = np.stack([np.interp(instants, seconds, column) for column in vectors.T], axis=1).astype(np.float32)
        poses = space.vectors.decode(between, instants, seconds)
        motion: Motion = poses.at(grid, self.skeleton)
        field = INTERPOLATORS["slerp"].encode(Observation.of(motion))
        assert isinstance(field, InterpolatedField)
        return replace(field, end_seconds=min(duration_seconds, field.end_seconds))

    def _seconds(self, request: GenerationRequest, seed: int, number: int) -> float:
        if request.duration_seconds is not None:
            return float(request.duration_seconds)
        row = torch.randint(len(self.trained.durations), (), generator=step_generator(seed, "duration", number))
        return float(self.trained.durations[row])

    def _conditions(self, requests: Sequence[GenerationRequest]) -> Conditions:
        """The network's conditions; a request without text or action gets the null condition."""
        settings, known = self.trained.config.conditions, self.trained.sizes.actions
        if settings.kind == "text":
            texts = list(dict.fromkeys(request.text for request in requests if request.text))
            rows = (
                embedded(self.text_encoder, settings, texts) if texts else torch.zeros((0, len(self.trained.nothing)))
            )
            of = dict(zip(texts, rows, strict=True)) | {"": self.trained.nothing}
            text = torch.stack([of[request.text] for request in requests])
        else:
            text = self.trained.nothing.expand(len(requests), -1)
        acts = [request.action if settings.kind == "action" else "" for request in requests]
        action = torch.tensor([known.index(each) if each else NO_ACTION for each in acts])
        given = (
            [bool(request.text) for request in requests] if settings.kind == "text" else [bool(each) for each in acts]
        )
        return Conditions(text, action, torch.tensor(given))

    def _diffusion(self, sampling: SamplingOptions) -> DiffusionConfig:
        network = self.trained.network
        assert isinstance(network, Sampler)
        own = network.diffusion
        if own is None:
            if sampling != SamplingOptions():
                raise UsageError(f"{self.name} has no guidance, sampler or number of steps to choose")
            return DiffusionConfig()
        return own.adjusted(sampling.sampler, sampling.steps, sampling.guidance_scale)


def load(peer: GenerativePeer, run: Path) -> PeerModel:
    """Load a peer from a run, onto a GPU if there is one; raises `RunError` if a stage is not trained."""
    device = resolve_device("auto")
    trained = load_stage(RunFolder(run), peer, peer.stages[-1].name, device)
    unconditional = not peer.conditional or trained.config.conditions.kind == "none"
    return PeerModel(peer.title, trained, device, unconditional)
