"""PA-HiRes as a trainable stage (`motionkit.stages`) and as an encoder of motions (`motionkit.encoders`)."""

from pathlib import Path
from typing import TYPE_CHECKING

from motionkit.training.stage import Stage, StageContext
from pahires.recipes import RECIPES, PaHiResConfig

if TYPE_CHECKING:
    from motionkit.clips.temporal.encoder import NetworkEncoder
    from pahires.model import PaHiRes

STAGE_NAME = "pahires"
NAME = "PA-HiRes"


def _train(context: StageContext, config: PaHiResConfig) -> None:
    from motionkit.clips.temporal.training import train_network

    train_network(context, STAGE_NAME, config, config.training, lambda num_numbers: _network(config, num_numbers))


def _check(context: StageContext, config: PaHiResConfig) -> None:
    from motionkit.clips.temporal.training import check_corpus

    check_corpus(context, config.training)


def _network(config: PaHiResConfig, num_numbers: int) -> "PaHiRes":
    from motionkit.clips.temporal.prediction import num_answers
    from pahires.model import PaHiRes

    return PaHiRes(config.network, num_numbers, num_answers(config.training.answer, num_numbers))


def load(run: Path) -> "NetworkEncoder":
    """A run's trained PA-HiRes; raises `RunError` or `CheckpointError` where there is none."""
    from motionkit.clips.temporal.encoder import NetworkEncoder
    from motionkit.clips.temporal.training import load_network

    trained = load_network(
        run,
        STAGE_NAME,
        PaHiResConfig,
        _network,
        lambda config: config.training,
        name=NAME,
    )
    return NetworkEncoder(trained)


STAGE = Stage(
    name=STAGE_NAME,
    order=60,
    description="continuous completion of observed frames: interpolation, in-betweening, extrapolation (PA-HiRes)",
    recipes=RECIPES,
    train=_train,
    check=_check,
    in_all=False,
)
