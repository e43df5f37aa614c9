"""A temporal network as a trainable stage and as a motion encoder; nothing heavy is imported before it is used.

A model of this kind is a configuration with the parts `network` and `training`, and a function that builds its network.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motionkit.training.stage import Stage, StageContext
from pahires.temporal.settings import NetworkMaker, TemporalConfig, TemporalConfigT

if TYPE_CHECKING:
    from pahires.temporal.encoder import NetworkEncoder


def temporal_stage(
    name: str,
    description: str,
    recipes: Mapping[str, Callable[[], TemporalConfigT]],
    make: NetworkMaker[TemporalConfigT],
) -> Stage[TemporalConfigT]:
    """The stage that trains the network built by `make`; not part of `--stage all`."""
    return Stage(name, description, recipes, partial(_train, name, make), in_all=False, check=_check)


def load_encoder(
    run: Path,
    stage: str,
    config_type: type[Any],
    make: NetworkMaker[Any],
    name: str | None = None,
) -> "NetworkEncoder":
    """Load a run's trained network as an encoder; raises `RunError` or `CheckpointError` if there is none."""
    from pahires.temporal.encoder import NetworkEncoder
    from pahires.temporal.training import load_network

    return NetworkEncoder(load_network(run, stage, config_type, make, name=name))


def _train(name: str, make: NetworkMaker[TemporalConfigT], context: StageContext, config: TemporalConfigT) -> None:
    from pahires.temporal.training import train_network

    train_network(context, name, config, make)


def _check(context: StageContext, config: TemporalConfig) -> None:
    """Raise early what would stop the training: no take at the framerate."""
    from motionkit.data.rotation_sequences import open_rotation_sequences

    settings = config.training
    open_rotation_sequences(
        context.open_store(), settings.framerate, where=settings.where or None, layout=settings.layout
    )
