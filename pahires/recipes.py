"""PA-HiRes's settings and named recipes (`nano`, `base`, `paper`, `demo`)."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from motionkit.clips.temporal.settings import TemporalSettings, base_training, nano_training
from motionkit.training.config import Schedule
from pahires.settings import NetworkSettings


@dataclass(frozen=True)
class PaHiResConfig:
    """The stage `pahires`: its network and its training."""

    network: NetworkSettings = field(default_factory=NetworkSettings)
    training: TemporalSettings = field(default_factory=TemporalSettings)


def paper() -> PaHiResConfig:
    """The paper's figures (§4.1), with what ../docs/deviations.md says where it is silent."""
    return PaHiResConfig(
        network=NetworkSettings(code=256, embedding=128),
        training=TemporalSettings(schedule=Schedule(epochs=1000, batch_size=256, learning_rate=1e-4, kind="steps")),
    )


def nano() -> PaHiResConfig:
    """One CPU core, a quarter of an hour: every task, corrections of an interpolation that leave given frames alone."""
    network = NetworkSettings(code=96, hidden=192, decoder_layers=4)
    return PaHiResConfig(network, _with_steps(_with_curves(nano_training()), 12_000))


def base() -> PaHiResConfig:
    """One GPU of the H100's kind for an hour: `nano` at the paper's widths."""
    return PaHiResConfig(network=NetworkSettings(code=256, embedding=128), training=_with_curves(base_training()))


def _with_curves(training: TemporalSettings) -> TemporalSettings:
    """What PA-HiRes alone has: weights of other curves, and corrections sized by the motion."""
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
