"""Settings of the native-rate evaluator and of the one for retrieval, and their recipes; imports nothing heavy."""

from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class NativeNetworkConfig:
    """Widths: convolutions, each direction of the GRU, the embedding, and the space shared with text."""

    convolution: int = 128
    recurrent: int = 128
    embedding: int = 128
    shared: int = 128
    text_hidden: int = 256


@dataclass(frozen=True)
class NativeTrainingConfig:
    """Batches of a training step, and the tasks' weights.

    A step draws one framerate from `framerates` (those that the store reaches) and one m, a multiple of 4 in
    `min_poses` … `max_poses`; `clean_fraction` of its clips stay unchanged, and `compound_fraction` of those that lost
    detail get noise too. Input statistics are those of `statistics_batches` batches. `bank_seconds` bounds the motion
    held in memory per framerate, `where` selects the store's sequences. `text_encoder` is "" (no text) or a name of
    `motionkit.training.text`.
    """

    steps: int = 1500
    batch_size: int = 128
    learning_rate: float = 2e-3
    warmup_fraction: float = 0.02
    weight_decay: float = 1e-4
    gradient_clip: float = 1.0
    framerates: tuple[float, ...] = (20.0, 24.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0)
    min_poses: int = 16
    max_poses: int = 64
    clean_fraction: float = 0.2
    compound_fraction: float = 0.5
    strength_weight: float = 1.0
    text_weight: float = 0.2
    text_temperature: float = 0.1
    text_encoder: str = "minilm"
    statistics_batches: int = 24
    bank_seconds: float = 1200.0
    where: str = "split NOT IN ('val', 'test')"

    def __post_init__(self) -> None:
        if not 8 <= self.min_poses <= self.max_poses or self.min_poses % 4 or self.max_poses % 4:
            raise ValueError("min_poses and max_poses must be multiples of 4 with 8 <= min_poses <= max_poses")
        if not 0 <= self.clean_fraction < 1:
            raise ValueError("clean_fraction must lie in [0, 1)")
        if not 0 <= self.compound_fraction <= 1:
            raise ValueError("compound_fraction must lie in [0, 1]")


@dataclass(frozen=True)
class NativeConfig:
    """All settings of a trained native-rate evaluator besides store and seed."""

    network: NativeNetworkConfig = field(default_factory=NativeNetworkConfig)
    training: NativeTrainingConfig = field(default_factory=NativeTrainingConfig)


def nano() -> NativeConfig:
    """Two cores, under three minutes."""
    return NativeConfig()


def demo() -> NativeConfig:
    """Two cores, well under a minute: enough to see every family, not to quote."""
    config = NativeConfig()
    return replace(config, training=replace(config.training, steps=250, batch_size=96, statistics_batches=12))


def base() -> NativeConfig:
    """One GPU: four times the width, long training."""
    return NativeConfig(
        network=NativeNetworkConfig(convolution=256, recurrent=512, embedding=256, shared=256, text_hidden=512),
        training=NativeTrainingConfig(steps=50_000, batch_size=512, learning_rate=5e-4, bank_seconds=36_000.0),
    )


def paper() -> NativeConfig:
    """The widths of Guo et al. (text-to-motion networks/modules.py): 512 convolutions, GRU 1024, embedding 512."""
    return NativeConfig(
        network=NativeNetworkConfig(convolution=512, recurrent=1024, embedding=512, shared=512, text_hidden=1024),
        training=NativeTrainingConfig(steps=200_000, batch_size=512, learning_rate=1e-4, bank_seconds=144_000.0),
    )


@dataclass(frozen=True)
class TmrTrainingConfig:
    """Batches of a training step of the stage `tmr`, and which pairs are negatives.

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


def tmr_nano() -> TmrConfig:
    """Two cores, under three minutes."""
    return TmrConfig()


def tmr_demo() -> TmrConfig:
    """Two cores, tens of seconds."""
    config = TmrConfig()
    return replace(config, training=replace(config.training, steps=150, batch_size=48, max_poses=96))


def tmr_base() -> TmrConfig:
    """One GPU: four times the width, long training."""
    return TmrConfig(
        network=NativeNetworkConfig(convolution=256, recurrent=512, embedding=256, shared=256, text_hidden=512),
        training=TmrTrainingConfig(steps=20_000, batch_size=256, learning_rate=3e-4, bank_seconds=36_000.0),
    )
