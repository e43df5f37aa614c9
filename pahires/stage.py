"""PA-HiRes as a trainable stage and as a motion encoder."""

from pathlib import Path
from typing import TYPE_CHECKING

from pahires.recipes import RECIPES, PaHiResConfig
from pahires.temporal.stage import load_encoder, temporal_stage

if TYPE_CHECKING:
    from pahires.model import PaHiRes
    from pahires.temporal.encoder import NetworkEncoder


def make_network(config: PaHiResConfig, num_features: int) -> "PaHiRes":
    """The network for rows of so many numbers."""
    from pahires.model import PaHiRes
    from pahires.temporal.prediction import num_answers

    return PaHiRes(config.network, num_features, num_answers(config.training.answer, num_features))


STAGE = temporal_stage(
    "pahires",
    "continuous completion of observed frames: interpolation, in-betweening, extrapolation (PA-HiRes)",
    RECIPES,
    make_network,
)


def load(run: Path) -> "NetworkEncoder":
    """Load a run's trained PA-HiRes; raises `RunError` or `CheckpointError` if there is none."""
    return load_encoder(run, STAGE.name, PaHiResConfig, make_network, "PA-HiRes")
