"""Settings of the TMR-style evaluator and its named recipes; imports nothing heavy."""

from dataclasses import dataclass, field, replace

from eval.native_evaluator.settings import NativeNetworkConfig


@dataclass(frozen=True)
class TmrTrainingConfig:
    """Batches of a training step, and which pairs are negatives.

    A step draws one framerate from `framerates` (those that the store reaches) and one duration between `min_seconds`
    and `max_seconds`, at most `max_poses` poses. Pairs whose sentences have a score above `same_above` (½ + ½ · cosine
    of `text_encoder`'s embeddings) are not negatives of each other. `noise` is the standard deviation of the noise
    added to the standardised inputs. `bank_seconds` bounds the motion held in memory per framerate, `where` selects the
    store's sequences.
    """

    steps: int = 600
    batch_size: int = 64
    learning_rate: float = 1e-3
    warmup_fraction: float = 0.05
    weight_decay: float = 1e-2
    gradient_clip: float = 1.0
    framerates: tuple[float, ...] = (20.0, 24.0, 30.0, 60.0)
    min_seconds: float = 1.0
    max_seconds: float = 6.0
    max_poses: int = 160
    temperature: float = 0.1
    same_above: float = 0.8
    noise: float = 0.1
    text_encoder: str = "minilm"
    statistics_batches: int = 8
    bank_seconds: float = 3600.0
    where: str = "split NOT IN ('val', 'test')"

    def __post_init__(self) -> None:
        if not 0 < self.min_seconds <= self.max_seconds or self.max_poses < 8:
            raise ValueError("0 < min_seconds <= max_seconds, and max_poses of at least 8")
        if self.temperature <= 0 or self.same_above <= 0:
            raise ValueError("temperature and same_above must be positive")
        if not self.text_encoder:
            raise ValueError("an evaluator of retrieval reads texts: text_encoder must name an encoder")


@dataclass(frozen=True)
class TmrConfig:
    """All settings of a trained TMR-style evaluator besides store and seed."""

    network: NativeNetworkConfig = field(default_factory=NativeNetworkConfig)
    training: TmrTrainingConfig = field(default_factory=TmrTrainingConfig)


def nano() -> TmrConfig:
    """Two cores, under three minutes."""
    return TmrConfig()


def demo() -> TmrConfig:
    """Two cores, tens of seconds."""
    config = TmrConfig()
    return replace(config, training=replace(config.training, steps=150, batch_size=48, max_poses=96))


def base() -> TmrConfig:
    """One GPU: four times the width, long training."""
    return TmrConfig(
        network=NativeNetworkConfig(convolution=256, recurrent=512, embedding=256, shared=256, text_hidden=512),
        training=TmrTrainingConfig(steps=20_000, batch_size=256, learning_rate=3e-4, bank_seconds=36_000.0),
    )
