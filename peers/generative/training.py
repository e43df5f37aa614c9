"""Training of a generative peer's network on motionkit's loop, and its checkpoint."""

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Float64
from motionkit.training.config import Schedule, from_plain, to_plain
from motionkit.training.devices import autocast, float32_products, resolve_device, with_precision_of
from motionkit.training.diffusion.settings import DiffusionConfig
from motionkit.training.loop import WeightAverage, dropout_from, seeded_initialisation, set_rate, train_loop
from motionkit.training.pose_vectors import VectorScaling, vector_tensors, vectors_of
from motionkit.training.run import RunError, RunFolder
from motionkit.training.stage import StageContext
from motionkit.training.tensors import (
    CheckpointError,
    load_tensors,
    load_training_tensors,
    prefixed,
    rebuilding,
    save_tensors,
    training_tensors,
    unprefixed,
)
from peers.generative.batches import ConditionSizes, MotionBatch, PoseSpace, SampleBatch
from peers.generative.corpus import MotionCorpus, check_captioned, open_corpus, text_encoder_of
from peers.generative.peer import GenerativePeer, PeerStage, stage_named
from peers.generative.settings import PeerConfig

FORMAT, FORMAT_VERSION = "motionkit-generative-peer", 1


@runtime_checkable
class PeerNetwork(Protocol):
    """A peer's network: an `nn.Module` built from (sizes, space, condition sizes, networks of earlier stages)."""

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Metrics of a batch, of which `loss` is minimised; randomness comes from `generator` (CPU)."""
        ...


@runtime_checkable
class Sampler(Protocol):
    """A network that can be sampled: that of a peer's last stage."""

    @property
    def diffusion(self) -> DiffusionConfig | None:
        """Diffusion settings; None if the network is no diffusion model."""
        ...

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows of motions; frames beyond a motion's length are undefined."""
        ...


@runtime_checkable
class StepAware(Protocol):
    """A network whose losses depend on training progress."""

    def begin_step(self, step: int, steps: int) -> None:
        """Called before step `step` (from 0) of `steps`."""
        ...


class PeerTraining:
    """A `motionkit.training.loop.Trainable`: owns the network, the average of its weights and the optimiser."""

    def __init__(
        self,
        config: PeerConfig,
        corpus: MotionCorpus,
        network: nn.Module,
        *,
        seed: int,
        device: torch.device,
    ) -> None:
        self.config, self.corpus, self.device = config, corpus, device
        self.network = network.to(device)
        self.steps = config.schedule.num_steps(len(corpus))
        self.average = WeightAverage(network, config.optimizer.ema_decay) if config.optimizer.ema_decay else None
        self.optimizer = torch.optim.AdamW(
            network.parameters(), lr=config.schedule.learning_rate, weight_decay=config.optimizer.weight_decay
        )

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """One optimiser step on a fresh batch."""
        schedule: Schedule = self.config.schedule
        set_rate(self.optimizer, schedule.factor(step, self.steps) * schedule.learning_rate)
        rows = torch.randint(len(self.corpus), (schedule.batch_size,), generator=generator)
        batch = self.corpus.batch(rows, generator, drop=self.config.conditions.drop).to(self.device)
        assert isinstance(self.network, PeerNetwork)
        if isinstance(self.network, StepAware):
            self.network.begin_step(step, self.steps)
        self.network.train()
        with dropout_from(generator, self.device), autocast(self.config.precision, self.device):
            figures = self.network.losses(batch, generator)
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(figures["loss"])
        if self.config.optimizer.clip_norm:
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.config.optimizer.clip_norm)
        self.optimizer.step()
        if self.average is not None:
            self.average.update(self.network, step)
        return {name: figure.detach() for name, figure in figures.items()}

    @property
    def trained_tensors(self) -> dict[str, Tensor]:
        """The weights to save: averaged if an average is kept."""
        return self.network.state_dict() if self.average is None else self.average.tensors()

    def state_tensors(self) -> dict[str, Tensor]:
        """Weights, their average, the optimiser's moments."""
        kept = {} if self.average is None else prefixed("average", self.average.tensors())
        return training_tensors("network", self.network, self.optimizer) | kept

    def load_state_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore what `state_tensors` returned."""
        load_training_tensors("network", self.network, self.optimizer, tensors)
        if self.average is not None:
            self.average.load(unprefixed("average", tensors))


@dataclass(frozen=True, eq=False)
class TrainedStage:
    """A stage's network in evaluation mode, with its training setup; `durations` are of its windows, in seconds."""

    config: Any
    network: nn.Module
    space: PoseSpace
    sizes: ConditionSizes
    durations: Float64[Tensor, "windows"]
    nothing: Float[Tensor, "text"]
    text_fingerprint: str


def train_stage(peer: GenerativePeer, stage: PeerStage, context: StageContext, config: Any) -> None:
    """Train a stage of a peer on the context's store; write RUN/STAGE/model.safetensors.

    Raises `RunError` if an earlier stage is not trained or was trained on other motions, and `UsageError` for a store
    without the motions or captions that it needs.
    """
    started = time.perf_counter()
    store, device = context.open_store(), resolve_device(context.device)
    config = with_precision_of(config, device)
    encoder = text_encoder_of(config.conditions)
    earlier = {name: load_stage(context.run, peer, name, device) for name in stage.builds_on}
    corpus = open_corpus(store, config, encoder)
    corpus = dataclasses.replace(corpus, scaling=_common_scaling(corpus, config, earlier))
    space = PoseSpace(corpus.vectors, corpus.scaling, config.motions.framerate).to(device)
    with seeded_initialisation(context.seed, stage.name):
        network = stage.make_network(
            config, space, corpus.sizes, {name: each.network for name, each in earlier.items()}
        )
    folder = context.begin(stage.name, config, store_fingerprint=store.fingerprint, builds_on=stage.builds_on)
    training = PeerTraining(config, corpus, network, seed=context.seed, device=device)
    with float32_products(config.precision):
        context.fit_budget(training, folder)
        figures = train_loop(training, folder, steps=training.steps, seed=context.seed, on_progress=context.on_progress)
    tensors = prefixed("network", training.trained_tensors) | {
        "scaling.mean": corpus.scaling.mean,
        "scaling.scale": corpus.scaling.scale,
        "durations": torch.from_numpy(corpus.windows.duration_seconds),
        "nothing": corpus.text[0],
        **vector_tensors(corpus.vectors),
    }
    description = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "stage": stage.name,
        "config": to_plain(config),
        "actions": list(corpus.sizes.actions),
        "text_fingerprint": "" if encoder is None else encoder.fingerprint,
        "store_fingerprint": store.fingerprint,
        "builds_on": context.run.fingerprints(stage.builds_on),
    }
    save_tensors(folder.model_path, tensors, description)
    facts = {
        "steps": training.steps,
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "fps": config.motions.fps,
        "windows": len(corpus),
        "captions": int(corpus.num_captions.sum()),
        "actions": len(corpus.sizes.actions),
    }
    folder.finish({**figures, **facts, "wall_seconds": round(time.perf_counter() - started, 1)})


def check_stage(context: StageContext, config: Any) -> None:
    """Raise early what would stop the training: missing captions or actions, a missing text encoder."""
    text_encoder_of(config.conditions)
    check_captioned(context.open_store(), config)


def _common_scaling(corpus: MotionCorpus, config: PeerConfig, earlier: Mapping[str, TrainedStage]) -> VectorScaling:
    """The scaling of the earlier stages, on whose outputs this stage trains; the corpus's own if there are none."""
    for name, stage in earlier.items():
        found, wanted = (
            dataclasses.replace(each.motions, seen="all", seen_frames=0) for each in (stage.config, config)
        )
        if found != wanted:
            raise RunError(
                f"{name} was trained on other motions ({found}, not {wanted}): give both stages the same `motions.…` "
                "settings"
            )
        return VectorScaling(stage.space.mean.cpu(), stage.space.scale.cpu())
    return corpus.scaling


def load_stage(run: RunFolder, peer: GenerativePeer, name: str, device: torch.device | None = None) -> TrainedStage:
    """Load a trained stage; raises `RunError` if it is missing, or an earlier stage has been trained again since."""
    stage, folder = stage_named(peer, name), run.stage(name)
    folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    found = tuple(description.get(key) for key in ("format", "version", "stage"))
    if found != (FORMAT, FORMAT_VERSION, name):
        raise CheckpointError(f"{folder.model_path} is {found}, expected {(FORMAT, FORMAT_VERSION, name)}")
    if description["builds_on"] != run.fingerprints(stage.builds_on):
        raise RunError(
            f"{', '.join(stage.builds_on)} was trained again after {folder.model_path}: "
            f"motionkit train --stage {name} --run {run.path.name} --overwrite"
        )
    where = device or torch.device("cpu")
    earlier = {each: load_stage(run, peer, each, where).network for each in stage.builds_on}
    with rebuilding(folder.model_path, name, tensors), seeded_initialisation(0, name):
        config = from_plain(stage.config_type, description["config"])
        vectors = vectors_of(config.motions.pose_vectors, tensors)
        scaling = VectorScaling(tensors["scaling.mean"], tensors["scaling.scale"])
        space = PoseSpace(vectors, scaling, config.motions.framerate).to(where)
        actions = tuple(map(str, description["actions"]))
        sizes = ConditionSizes(len(tensors["nothing"]), actions, len(tensors["durations"]))
        network = stage.make_network(config, space, sizes, earlier)
        network.load_state_dict(unprefixed("network", tensors))
    return TrainedStage(
        config=config,
        network=network.to(where).eval().requires_grad_(False),
        space=space,
        sizes=sizes,
        durations=tensors["durations"],
        nothing=tensors["nothing"],
        text_fingerprint=str(description["text_fingerprint"]),
    )
