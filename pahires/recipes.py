"""PA-HiRes's settings and named recipes (`nano`, `base`, `paper`, `demo`)."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

from motionkit.clips.temporal.settings import TemporalSettings, base_training, nano_training
from pahires.settings import NetworkSettings


@dataclass(frozen=True)
class PaHiResConfig:
    """The stage `pahires`: its network and its training."""

    network: NetworkSettings = dataclasses.field(default_factory=NetworkSettings)
    training: TemporalSettings = dataclasses.field(default_factory=TemporalSettings)


def paper() -> PaHiResConfig:
    """The paper's figures (§4.1), with what ../docs/deviations.md says where it is silent."""
    return PaHiResConfig(
        network=NetworkSettings(code=256, embedding=128),
        training=TemporalSettings(
            form="plain", steps=None, epochs=1000, batch=256, rate=1e-4, schedule="steps", rate_warmup_fraction=0.0
        ),
    )


def nano() -> PaHiResConfig:
    """One CPU core, a quarter of an hour: every task, corrections of an interpolation that leave given frames alone."""
    training = dataclasses.replace(_with_curves(nano_training()), steps=12_000)
    return PaHiResConfig(network=NetworkSettings(code=96, hidden=192, decoder_layers=4), training=training)


def base() -> PaHiResConfig:
    """One GPU of the H100's kind for an hour: `nano` at the paper's widths."""
    return PaHiResConfig(network=NetworkSettings(code=256, embedding=128), training=_with_curves(base_training()))


def _with_curves(training: TemporalSettings) -> TemporalSettings:
    """What PA-HiRes alone has: weights of other curves, and corrections sized by the motion."""
    return dataclasses.replace(training, sizing="motion", blended=("catmull-rom", "linear"), balance_floor=0.05)


def demo() -> PaHiResConfig:
    """A minute on the embedded corpus: `nano` with fewer steps."""
    return dataclasses.replace(nano(), training=dataclasses.replace(nano().training, steps=600))


RECIPES: dict[str, Callable[[], PaHiResConfig]] = {"nano": nano, "demo": demo, "base": base, "paper": paper}
