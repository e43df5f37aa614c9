"""PA-HiRes's settings and recipes (`nano`, `base`, `paper`, `demo`); imports nothing heavy."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

from motionkit.training.config import Schedule
from pahires.temporal.settings import TemporalConfig, TemporalSettings, base_training, nano_training

# calibrated: unit variance and slope; staf: STAF's code; siren: sin(x).
Initialisation = Literal["calibrated", "staf", "siren"]


@dataclass(frozen=True)
class NetworkSettings:
    """PA-HiRes's network.

    `frames_per_scale`: N_s, even, one for each of the S scales, fine to coarse. `code`: width of the latent codes z_s,
    cut into `attention_tokens` tokens; `encoder_layers`: activated layers of each F_s. `hidden`, `decoder_layers`: the
    decoder D (paper §4.1: 256, 5). `num_sines`: ζ. `shared_activation`: one σ for all layers (Table 4's ablation).
    `time_band`: the highest frequency of the Fourier features of the place within a segment, radians.
    """

    frames_per_scale: tuple[int, ...] = (2, 6, 14)
    embedding: int = 64
    code: int = 128
    encoder_layers: int = 2
    attention_tokens: int = 8
    hidden: int = 256
    decoder_layers: int = 5
    num_sines: int = 16
    shared_activation: bool = False
    initialisation: Initialisation = "calibrated"
    time_features: int = 16
    time_band: float = 8.0

    def __post_init__(self) -> None:
        scales = self.frames_per_scale
        if not scales or any(count < 2 or count % 2 for count in scales) or any(a >= b for a, b in pairwise(scales)):
            raise ValueError(f"frames_per_scale must be even and increasing, such as 2,6,14, not {scales}")
        if self.code % self.attention_tokens:
            raise ValueError(
                f"attention_tokens must divide code, but {self.attention_tokens} does not divide {self.code}"
            )
        for name in ("code", "encoder_layers", "hidden", "decoder_layers", "num_sines", "time_features"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be 1 or more, not {getattr(self, name)}")


@dataclass(frozen=True)
class PaHiResConfig(TemporalConfig):
    """The stage `pahires`: its network and its training."""

    network: NetworkSettings = field(default_factory=NetworkSettings)


def paper() -> PaHiResConfig:
    """The paper's settings (§4.1); where it is silent, those of docs/deviations.md."""
    return PaHiResConfig(
        network=NetworkSettings(code=256, embedding=128),
        training=TemporalSettings(schedule=Schedule(epochs=1000, batch_size=256, learning_rate=1e-4, kind="steps")),
    )


def nano() -> PaHiResConfig:
    """A quarter of an hour on one CPU core: all tasks, as corrections to an interpolation that keep given frames."""
    network = NetworkSettings(code=96, hidden=192, decoder_layers=4)
    return PaHiResConfig(network, _with_steps(_with_curves(nano_training()), 12_000))


def base() -> PaHiResConfig:
    """An hour on an H100: `nano` at the paper's widths."""
    return PaHiResConfig(network=NetworkSettings(code=256, embedding=128), training=_with_curves(base_training()))


def _with_curves(training: TemporalSettings) -> TemporalSettings:
    """PA-HiRes' additions: weights of other curves, and corrections scaled by the motion."""
    return replace(
        training,
        answer=replace(training.answer, sizing="motion", blended=("catmull-rom", "linear")),
        loss=replace(training.loss, balance_floor=0.05),
    )


def _with_steps(training: TemporalSettings, steps: int) -> TemporalSettings:
    return replace(training, schedule=replace(training.schedule, steps=steps))


def demo() -> PaHiResConfig:
    """A minute on the embedded corpus: `nano` with fewer steps."""
    return replace(nano(), training=_with_steps(nano().training, 600))


RECIPES: dict[str, Callable[[], PaHiResConfig]] = {"nano": nano, "demo": demo, "base": base, "paper": paper}
