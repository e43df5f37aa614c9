"""PA-HiRes as a trainable stage (`motionkit.stages`)."""

from typing import TYPE_CHECKING

from pahires.recipes import RECIPES, PaHiResConfig
from pahires.temporal.stage import temporal_stage

if TYPE_CHECKING:
    from pahires.model import PaHiRes


def make_network(config: PaHiResConfig, num_features: int) -> "PaHiRes":
    """The network for rows of so many numbers."""
    from pahires.model import PaHiRes
    from pahires.temporal.prediction import num_answers

    return PaHiRes(config.network, num_features, num_answers(config.training.answer, num_features))


STAGE = temporal_stage(
    "pahires",
    60,
    "continuous completion of observed frames: interpolation, in-betweening, extrapolation (PA-HiRes)",
    RECIPES,
    make_network,
)
