"""A temporal network as a trainable stage and as a motion encoder, and its file."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from motionkit.data.rotation_sequences import RotationSequences, open_rotation_sequences
from motionkit.store.reader import Store
from motionkit.store.schema import skeleton_from_row, skeleton_row
from motionkit.training.config import from_plain, to_plain
from motionkit.training.loop import (
    CheckpointError,
    load_tensors,
    prefixed,
    rebuilding,
    run_training,
    save_tensors,
    seeded_initialisation,
    unprefixed,
)
from motionkit.training.networks import VectorScaling, resolve_device
from motionkit.training.run import RunFolder, Stage, StageContext
from pahires.temporal.encoder import NetworkEncoder
from pahires.temporal.prediction import Predictor
from pahires.temporal.settings import TemporalConfig, TemporalSettings
from pahires.temporal.training import TemporalTraining, TrainedNetwork
from pahires.temporal.windows import WindowSampler

FORMAT, FORMAT_VERSION = "temporal-network", 3


@dataclass(frozen=True)
class TemporalSystem:
    """A model that completes motion; it differs from others of this kind in its network alone.

    `name` is its stage's. `make_network` builds the network from a configuration and the numbers per row, initialised
    by torch's global generator; `recipes` map names to functions that make a configuration of the type `config_type`.
    """

    name: str
    description: str
    config_type: type[TemporalConfig]
    make_network: Callable[[Any, int], torch.nn.Module]
    recipes: Mapping[str, Callable[[], Any]]

    @property
    def stage(self) -> Stage[Any]:
        """The stage that trains the network."""
        return Stage(self.name, self.description, self.recipes, self.train, check=self.check)

    def check(self, context: StageContext, config: TemporalConfig) -> None:
        """Raise early what would stop the training: no take at the framerate."""
        open_takes(context.open_store(), config.training)

    def train(self, context: StageContext, config: TemporalConfig) -> None:
        """Train the network on the context's store; write RUN/STAGE/model.safetensors.

        Raises what `open_rotation_sequences` and `train_loop` raise.
        """
        started, settings = time.perf_counter(), config.training
        store, device = context.open_store(), resolve_device(context.device)
        takes = open_takes(store, settings)
        folder = context.begin(self.name, config, store_fingerprint=store.fingerprint)
        with seeded_initialisation(context.seed, self.name):
            network = self.make_network(config, takes.num_features)
        training = TemporalTraining(network, WindowSampler(takes, settings), seed=context.seed, device=device)
        figures = run_training(context, training, folder)
        tensors = prefixed("network", training.learner.trained_tensors())
        description = {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "stage": self.name,
            "config": to_plain(config),
            "skeleton": skeleton_row(takes.skeleton),
        }
        save_tensors(folder.model_path, tensors | prefixed("scaling", vars(training.scaling)), description)
        hours = float(takes.num_frames.sum()) / float(settings.framerate) / 3600
        facts = {"takes": len(takes.num_frames), "takes_skipped": takes.skipped, "hours": round(hours, 3)}
        folder.finish({**figures, **facts, "wall_seconds": round(time.perf_counter() - started, 1)})

    def load(self, run: Path, title: str | None = None) -> NetworkEncoder:
        """A run's trained network as an encoder; raises `RunError` or `CheckpointError` if there is none."""
        return NetworkEncoder(self.load_network(run, title))

    def load_network(self, run: Path, title: str | None = None) -> TrainedNetwork:
        """A run's trained network, on the CPU; raises `RunError` or `CheckpointError` if there is none of this kind."""
        folder = RunFolder(run).stage(self.name)
        if not folder.model_path.is_file():
            folder.read_summary()
        tensors, description = load_tensors(folder.model_path)
        kind = tuple(description.get(key) for key in ("format", "version", "stage"))
        if kind != (FORMAT, FORMAT_VERSION, self.name):
            raise CheckpointError(
                f"{folder.model_path} is {kind}, expected {(FORMAT, FORMAT_VERSION, self.name)}: train it again "
                f"(motionkit train --stage {self.name} --overwrite)"
            )
        with rebuilding(folder.model_path, self.name):
            config = from_plain(self.config_type, description["config"])
            scaling = VectorScaling(tensors["scaling.mean"], tensors["scaling.scale"])
            network = self.make_network(config, len(scaling.mean))
            network.load_state_dict(unprefixed("network", tensors))
            skeleton = skeleton_from_row(description["skeleton"])
        return TrainedNetwork(
            name=title or self.name,
            predictor=Predictor(network.eval().requires_grad_(False), scaling, config.training.answer),
            settings=config.training,
            skeleton=skeleton,
        )


def open_takes(store: Store, settings: TemporalSettings) -> RotationSequences:
    """The takes that a network is trained on; raises what `open_rotation_sequences` raises."""
    return open_rotation_sequences(store, settings.framerate, where=settings.where or None, layout=settings.layout)
