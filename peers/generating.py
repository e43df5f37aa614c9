"""A generative system: its stages with their networks and recipes, their training, and the trained model.

A trained system gives frames at its own framerate, and SLERP between them.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.interpolation import INTERPOLATORS, InterpolatedField
from motionkit.fields.motion_field import MotionField, Observation
from motionkit.generate.models import GenerationRequest, SamplingOptions
from motionkit.training import loop
from motionkit.training.config import DiffusionConfig, Precision, Schedule, from_plain, specialised, to_plain
from motionkit.training.loop import step_generator
from motionkit.training.networks import (
    Conditions,
    ConditionSizes,
    VectorScaling,
    autocast,
    resolve_device,
    vector_tensors,
    vectors_of,
    with_precision_of,
)
from motionkit.training.run import RunError, RunFolder, Stage, StageContext
from motionkit.training.text import TextEncoder, load_same_encoder
from peers.layers import NetworkInputs, PeerNetwork, TransformerSizes
from peers.motions import ConditionsConfig, MotionCorpus, MotionsConfig, PoseSpace, SampleBatch, open_corpus

MOTIONS_PER_BATCH = 64


@dataclass(frozen=True)
class PeerConfig:
    """A stage's configuration; the part `network` has the sizes of its own network.

    AdamW; `ema_decay` above 0 saves an exponential moving average of the weights; `clip_norm` above 0 clips the
    gradient's norm.
    """

    network: Any = None
    schedule: Schedule = Schedule(epochs=1)
    conditions: ConditionsConfig = ConditionsConfig()
    motions: MotionsConfig = MotionsConfig()
    precision: Precision = "float32"
    ema_decay: float = 0.0
    weight_decay: float = 0.0
    clip_norm: float = 0.0


def cosine(steps: int, batch_size: int, learning_rate: float, warmup_fraction: float = 0.02) -> Schedule:
    """A schedule with a short warm-up, then half a cosine."""
    return Schedule(steps, None, batch_size, learning_rate, "cosine", warmup_fraction)


def dropping(epochs: int, batch_size: int, learning_rate: float = 1e-3) -> Schedule:
    """A schedule whose learning rate falls by a hundredth after every epoch."""
    return Schedule(None, epochs, batch_size, learning_rate, "steps", drop=0.99, drop_every=1 / epochs)


UNCONDITIONAL, CLIP, MINILM = ConditionsConfig("none"), ConditionsConfig(), ConditionsConfig(text_encoder="minilm")
# Without diffusion there is no guidance, so no condition is dropped.
GIVEN, GIVEN_MINILM, GIVEN_ACTION = (replace(each, drop=0.0) for each in (CLIP, MINILM, ConditionsConfig("action")))
# Every twelfth frame of KIT's 100 fps; 9.8 s, as the others.
SLOW = MotionsConfig(fps=25 / 3, max_frames=82)
# Two heads of 64 and no dropout: attention over 196 frames is twice as fast on a CPU.
SMALL = TransformerSizes(4, 128, 2, 256, dropout=0.0)


@dataclass(frozen=True)
class PeerStage:
    """One training stage of a system; the network of its last stage generates.

    The recipe `paper` has the published sizes, batch size and steps; `nano` trains small networks in about the
    processor time of NeRM's `nano`, 18 minutes on one core for all stages together. `share` is its share of the
    system's time budget.
    """

    name: str
    network: Callable[[Any, NetworkInputs], PeerNetwork]
    nano: PeerConfig
    paper: PeerConfig
    builds_on: "PeerStage | None" = None
    share: float = 1.0

    @cached_property
    def config_type(self) -> type[PeerConfig]:
        """The type of its configurations."""
        sizes = type(self.paper.network)
        return specialised(PeerConfig, sizes.__name__.replace("Network", ""), network=sizes)

    @property
    def earlier(self) -> tuple[str, ...]:
        """The name of the stage that it builds on, if it does."""
        return (self.builds_on.name,) if self.builds_on else ()

    @property
    def stage(self) -> Stage[Any]:
        """The trainable stage."""
        return Stage(
            self.name,
            (self.network.__doc__ or "").partition("\n")[0],
            {name: partial(self.config_type, **vars(getattr(self, name))) for name in ("nano", "paper")},
            partial(train_stage, self),
            check=check_stage,
            builds_on=lambda config: self.earlier,
            share=self.share,
        )

    def load(self, run: Path, title: str = "", device_name: str = "auto") -> "PeerModel":
        """Load it from a run; raises `RunError` if it is not trained, or its earlier stage was trained again since."""
        name, folder, device = self.name, RunFolder(run).stage(self.name), resolve_device(device_name)
        folder.read_summary()
        tensors, description = loop.load_tensors(folder.model_path)
        if description.get("builds_on") != RunFolder(run).fingerprints(self.earlier):
            raise RunError(
                f"{', '.join(self.earlier)} was trained again after {folder.model_path}: "
                f"motionkit train --stage {name} --run {run.name} --overwrite"
            )
        earlier = self.builds_on.load(run, device_name=device_name).network if self.builds_on else None
        with loop.rebuilding(folder.model_path, name), loop.seeded_initialisation(0, name):
            config = from_plain(self.config_type, description["config"])
            scaling = VectorScaling(tensors["scaling.mean"], tensors["scaling.scale"]).to(device)
            space = PoseSpace(vectors_of(config.motions.pose_vectors, tensors), scaling, config.motions.framerate)
            sizes = ConditionSizes(len(tensors["nothing"]), tuple(map(str, description["actions"])))
            network = self.network(config.network, NetworkInputs(space, sizes, len(tensors["durations"]), earlier))
            network.load_state_dict(loop.unprefixed("network", tensors))
        network = network.to(device).eval().requires_grad_(False)
        fingerprint = str(description["text_fingerprint"])
        return PeerModel(
            title or name, config, network, space, sizes, tensors["durations"], tensors["nothing"], fingerprint, device
        )


class PeerTraining:
    """A `motionkit.training.loop.Trainable`: the training of a stage's network on a corpus."""

    def __init__(self, config: PeerConfig, corpus: MotionCorpus, network: PeerNetwork, device: torch.device) -> None:
        self.config, self.corpus, self.device = config, corpus, device
        self.network = network.to(device)
        self.steps = config.schedule.num_steps(len(corpus))
        optimizer = torch.optim.AdamW(
            network.parameters(), lr=config.schedule.learning_rate, weight_decay=config.weight_decay
        )
        self.learner = loop.Learner(network, optimizer, config.ema_decay)
        self.state_tensors, self.load_state_tensors = self.learner.state_tensors, self.learner.load_state_tensors

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """One optimiser step on a fresh batch."""
        schedule = self.config.schedule
        rows = torch.randint(len(self.corpus), (schedule.batch_size,), generator=generator)
        batch = self.corpus.batch(rows, generator, drop=self.config.conditions.drop)
        with loop.dropout_from(generator, self.device), autocast(self.config.precision, self.device):
            figures = self.network.train().losses(batch.at_step(step, self.steps, self.device))
        rate = schedule.factor(step, self.steps) * schedule.learning_rate
        self.learner.descend(figures["loss"], step, rate, self.config.clip_norm)
        return {name: figure.detach() for name, figure in figures.items()}


def train_stage(stage: PeerStage, context: StageContext, config: PeerConfig) -> None:
    """Train a stage on the context's store; write RUN/STAGE/model.safetensors.

    Raises `RunError` if an earlier stage is not trained or was trained on other motions, and `UsageError` for a store
    without the motions or captions that it needs.
    """
    started = time.perf_counter()
    store, device = context.open_store(), resolve_device(context.device)
    config = with_precision_of(config, device)
    encoder = config.conditions.load_encoder()
    earlier = stage.builds_on.load(context.run.path, device_name=context.device) if stage.builds_on else None
    corpus = open_corpus(store, config.motions, config.conditions, encoder)
    if earlier is not None:
        theirs, own = (replace(each.motions, sampled_frames=0) for each in (earlier.config, config))
        if theirs != own:
            raise RunError(
                f"{earlier.name} was trained on other motions ({theirs}, not {own}): give both stages the same "
                "`motions.…` settings"
            )
        corpus = replace(corpus, scaling=earlier.space.scaling.to(torch.device("cpu")))
    scaling, sizes = corpus.scaling, corpus.conditions.sizes
    space = PoseSpace(corpus.vectors, scaling.to(device), config.motions.framerate)
    with loop.seeded_initialisation(context.seed, stage.name):
        inputs = NetworkInputs(space, sizes, len(corpus), earlier.network if earlier else None)
        network = stage.network(config.network, inputs)
    folder = context.begin(stage.name, config, store_fingerprint=store.fingerprint, builds_on=stage.earlier)
    training = PeerTraining(config, corpus, network, device)
    figures = loop.run_training(context, training, folder)
    tensors = {
        **loop.prefixed("network", training.learner.trained_tensors()),
        **loop.prefixed("scaling", vars(scaling)),
        "durations": torch.from_numpy(corpus.poses.windows.duration_seconds),
        "nothing": corpus.conditions.text[0],
        **vector_tensors(corpus.vectors),
    }
    description = {
        "config": to_plain(config),
        "actions": list(sizes.actions),
        "text_fingerprint": "" if encoder is None else encoder.fingerprint,
        "builds_on": context.run.fingerprints(stage.earlier),
    }
    loop.save_tensors(folder.model_path, tensors, description)
    facts = {
        "steps": training.steps,
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "fps": config.motions.fps,
        "windows": len(corpus),
        "captions": int(corpus.conditions.num_captions.sum()),
        "actions": len(sizes.actions),
    }
    folder.finish({**figures, **facts, "wall_seconds": round(time.perf_counter() - started, 1)})


def check_stage(context: StageContext, config: PeerConfig) -> None:
    """Raise early what would stop the training: missing captions or actions, a missing text encoder."""
    config.conditions.load_encoder()
    columns = context.open_store().columns("captions", "action")
    config.conditions.check(bool(columns["captions"].map(len).any()), bool(set(columns["action"]) - {""}))


@dataclass(frozen=True, eq=False)
class PeerModel:
    """A `motionkit.generate.models.GenerativeModel`: a network in evaluation mode, with its training setup.

    `name` is that of its rows; `durations` are of its training windows, in seconds; `nothing` is the null text.
    """

    name: str
    config: PeerConfig
    network: PeerNetwork
    space: PoseSpace
    sizes: ConditionSizes
    durations: Float64[Tensor, "windows"]
    nothing: Float[Tensor, "text"]
    text_fingerprint: str
    device: torch.device

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of its pose vectors."""
        return self.space.vectors.skeleton

    @property
    def max_training_fps(self) -> Fraction:
        """The one framerate that it was trained at."""
        return self.space.fps

    @property
    def max_duration_seconds(self) -> float:
        """The longest motion that it was trained on."""
        return self.config.motions.max_duration_seconds

    @property
    def unconditional(self) -> bool:
        """Whether it takes no text and no action."""
        return self.config.conditions.kind == "none"

    @property
    def always_conditioned(self) -> bool:
        """Whether it learnt from no motion without its condition, but for those that have none."""
        return not (self.unconditional or self.config.conditions.drop)

    def text_encoder(self) -> TextEncoder | None:
        """The encoder it was trained with, None without texts; raises `RunError` where its weights have changed."""
        return self._text_encoder if self.config.conditions.kind == "text" else None

    @cached_property
    def _text_encoder(self) -> TextEncoder:
        return load_same_encoder(self.config.conditions.text_encoder, self.text_fingerprint, self.name)

    def check(self, request: GenerationRequest, sampling: SamplingOptions = SamplingOptions()) -> None:
        """Raise `UsageError` for a duration, text, action or sampling option that this model does not support."""
        self._diffusion(sampling)
        seconds, longest, kind = request.duration_seconds, self.max_duration_seconds, self.config.conditions.kind
        if seconds is not None and not 0 < seconds <= longest + 1e-9:
            raise UsageError(f"{self.name} generates more than 0 and up to {longest:g} s, not {seconds:g} s")
        if self.unconditional and (request.text or request.action):
            raise UsageError(f"this {self.name} knows no texts and no actions: ask unconditionally")
        if request.text and kind != "text" and not request.action:
            raise UsageError(f"this {self.name} was trained without texts (conditions.kind={kind})")
        if not (request.text and kind == "text"):
            self.sizes.action_index(request.action)

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
        fps, most = float(self.max_training_fps), self.config.motions.max_frames + 1
        seconds = [self._seconds(request, seed, first + row) for row, request in enumerate(requests)]
        # A batch is padded to its longest motion: motions of similar length are batched together.
        rows = sorted(range(len(requests)), key=seconds.__getitem__)
        fields: dict[int, MotionField] = {}
        for start in range(0, len(rows), MOTIONS_PER_BATCH):
            some = rows[start : start + MOTIONS_PER_BATCH]
            lengths = [min(ceil(seconds[row] * fps - 1e-6) + 1, most) for row in some]
            conditions = self._conditions([requests[row] for row in some], [seconds[row] for row in some])
            diffusion = self._diffusion(sampling)
            batch = SampleBatch(
                torch.tensor(lengths),
                conditions.to(self.device),
                conditions.unconditional(self.nothing).to(self.device),
                [step_generator(seed, "generate", first + row) for row in some],
                replace(diffusion, guidance_scale=conditions.guidance(diffusion.guidance_scale)),
            )
            with torch.inference_mode():
                sampled = self.network.sample(batch).to(self.device, torch.float32)
                vectors = self.space.scaling.invert(sampled).cpu().numpy()
            if not np.isfinite(vectors).all():
                raise UsageError(f"sampling diverged: a guidance scale of {diffusion.guidance_scale:g} is too large")
            for row, length, own in zip(some, lengths, vectors, strict=True):
                fields[row] = self._field(own[:length], seconds[row])
        return [fields[row] for row in range(len(requests))]

    def _field(self, vectors: Float32[np.ndarray, "frames numbers"], duration_seconds: float) -> MotionField:
        """Poses at the model's own framerate, interpolated by SLERP over the requested duration."""
        grid = TimeGrid(self.space.fps, len(vectors))
        seconds = grid.seconds()
        instants = self.space.vectors.instants(seconds)
        between = np.stack([np.interp(instants, seconds, column) for column in vectors.T], axis=1).astype(np.float32)
        motion = self.space.vectors.decode(between, instants, seconds).at(grid, self.skeleton)
        field = INTERPOLATORS["slerp"].encode(Observation.of(motion))
        assert isinstance(field, InterpolatedField)
        return replace(field, end_seconds=min(duration_seconds, field.end_seconds))

    def _seconds(self, request: GenerationRequest, seed: int, number: int) -> float:
        if request.duration_seconds is not None:
            return float(request.duration_seconds)
        row = torch.randint(len(self.durations), (), generator=step_generator(seed, "duration", number))
        return float(self.durations[row])

    def _conditions(self, requests: Sequence[GenerationRequest], seconds: Sequence[float]) -> Conditions:
        """The network's conditions; a request without text or action gets the null condition."""
        settings = self.config.conditions
        texts = [request.text if settings.kind == "text" else "" for request in requests]
        actions = [request.action if settings.kind == "action" else "" for request in requests]
        named = list(dict.fromkeys(text for text in texts if text))
        rows = settings.embedded(self._text_encoder.encode(named), named) if named else ()
        embedding = dict(zip(named, rows, strict=True)) | {"": self.nothing}
        return Conditions(
            text=torch.stack([embedding[text] for text in texts]),
            action=torch.tensor([self.sizes.action_index(action) for action in actions]),
            given=torch.tensor([bool(text or action) for text, action in zip(texts, actions, strict=True)]),
            duration=torch.tensor(seconds, dtype=torch.float32) / self.max_duration_seconds,
        )

    def _diffusion(self, sampling: SamplingOptions) -> DiffusionConfig:
        own = self.network.diffusion
        if own is not None:
            return own.adjusted(sampling.sampler, sampling.steps, sampling.guidance_scale)
        if sampling != SamplingOptions():
            raise UsageError(f"{self.name} has no guidance, sampler or number of steps to choose")
        return DiffusionConfig()
