"""A temporal network as a trainable stage and as a motion encoder."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from motionkit.data.rotation_sequences import open_rotation_sequences
from motionkit.training.run import Stage, StageContext
from pahires.temporal.encoder import NetworkEncoder
from pahires.temporal.settings import TemporalConfig
from pahires.temporal.training import load_network, train_network


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
        return Stage(self.name, self.description, self.recipes, self.train, check=check_takes)

    def train(self, context: StageContext, config: TemporalConfig) -> None:
        """Train the network (`train_network`)."""
        train_network(context, self.name, config, self.make_network)

    def load(self, run: Path, title: str | None = None) -> NetworkEncoder:
        """Load a run's trained network as an encoder; raises `RunError` or `CheckpointError` if there is none."""
        return NetworkEncoder(load_network(run, self.name, self.config_type, self.make_network, name=title))


def check_takes(context: StageContext, config: TemporalConfig) -> None:
    """Raise early what would stop the training: no take at the framerate."""
    settings = config.training
    where = settings.where or None
    open_rotation_sequences(context.open_store(), settings.framerate, where=where, layout=settings.layout)
