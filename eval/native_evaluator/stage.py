"""The stages `evaluator` and `tmr` of `motionkit train`: their settings and recipes; imports nothing heavy."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

from motionkit.core.plugins import lazily
from motionkit.training.config import Schedule
from motionkit.training.run import Stage


@dataclass(frozen=True)
class NetworkConfig:
    """Widths of the convolutions, each direction of the GRU, the space shared with text, and the text's hidden layer.

    `dropout` is that of hidden layers in training. With `unit_length` embeddings have length 1 (TMR).
    """

    convolution: int = 128
    recurrent: int = 128
    shared: int = 128
    text_hidden: int = 256
    dropout: float = 0.3
    unit_length: bool = False


@dataclass(frozen=True)
class TrainingConfig:
    """Which clips and sentences a step draws, and which of the pairs are negatives.

    A step draws one framerate of `framerates` (those that the store reaches) and one duration between `min_seconds`
    and `max_seconds`, at most `max_poses` poses. Logits are negative squared distances, divided by twice the
    `temperature`. Pairs whose sentences have a score above `same_above` (½ + ½ · cosine of `text_encoder`'s embeddings)
    are not negatives of each other. `noise` is the standard deviation of the noise added to the standardised inputs,
    whose statistics are those of `statistics_batches` batches. `bank_seconds` bounds the motion held in memory per
    framerate, `where` selects the store's sequences.
    """

    framerates: tuple[float, ...] = (20.0, 30.0, 60.0, 120.0)
    min_seconds: float = 1.0
    max_seconds: float = 6.0
    max_poses: int = 160
    temperature: float = 6.4
    same_above: float = 0.999
    noise: float = 0.0
    text_encoder: str = "minilm"
    weight_decay: float = 1e-4
    gradient_clip: float = 1.0
    statistics_batches: int = 8
    bank_seconds: float = 3600.0
    where: str = "split NOT IN ('val', 'test')"

    def __post_init__(self) -> None:
        if not 0 < self.min_seconds <= self.max_seconds or self.max_poses < 8:
            raise ValueError("0 < min_seconds <= max_seconds, and max_poses of at least 8")


@dataclass(frozen=True)
class EvaluatorConfig:
    """All settings of an evaluator besides store and seed."""

    network: NetworkConfig = field(default_factory=NetworkConfig)
    training: TrainingConfig = field(default_factory=TrainingConfig)
    schedule: Schedule = field(default_factory=lambda: Schedule(steps=1500))


WIDE = NetworkConfig(convolution=256, recurrent=512, shared=256, text_hidden=512)
# The widths of Guo et al. (text-to-motion, networks/modules.py).
GUO = NetworkConfig(convolution=512, recurrent=1024, shared=512, text_hidden=1024)
# Network, steps, batch size, learning rate, seconds of motion per framerate. nano takes under three minutes
# of two cores, base and paper are for a GPU.
SIZES = {
    "nano": (NetworkConfig(), 2200, 64, 2e-3, 3600.0),
    "small": (NetworkConfig(), 2200, 64, 2e-3, 3600.0),
    "demo": (NetworkConfig(), 250, 64, 2e-3, 3600.0),
    "base": (WIDE, 50_000, 512, 5e-4, 36_000.0),
    "paper": (GUO, 200_000, 512, 1e-4, 144_000.0),
}


def native(recipe: str) -> EvaluatorConfig:
    """The native evaluator: Euclidean distances, only pairs with the same sentence are no negatives."""
    network, steps, batch_size, rate, bank_seconds = SIZES[recipe]
    schedule = Schedule(steps, None, batch_size, rate, kind="cosine", warmup_fraction=0.02)
    return EvaluatorConfig(network, TrainingConfig(bank_seconds=bank_seconds), schedule)


def tmr(recipe: str) -> EvaluatorConfig:
    """The same network with TMR's loss: cosines of unit vectors, nearly equal sentences are no negatives.

    Petrovich et al. 2023; src/model/losses.py of Mathux/TMR @ 6d74688. TMR's decoder, reconstruction loss and Gaussian
    latents are left out: they serve generation.
    """
    config = native(recipe)
    training = replace(config.training, temperature=0.1, same_above=0.8, noise=0.1, weight_decay=1e-2)
    return replace(config, network=replace(config.network, unit_length=True), training=training)


def _stage(
    name: str, description: str, recipe: Callable[[str], EvaluatorConfig], share: float
) -> Stage[EvaluatorConfig]:
    train = partial(lazily("eval.native_evaluator.training:train_evaluator"), name)
    return Stage(name, description, {each: partial(recipe, each) for each in SIZES}, train, share=share)


EVALUATOR = _stage("evaluator", "the native evaluator of text and motion, at every framerate", native, 0.2)
TMR = _stage("tmr", "a small evaluator of text-motion retrieval, after TMR", tmr, 1.0)
