"""PA-HiRes's settings and named recipes (`nano`, `base`, `paper`, `demo`)."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

from pahires.network_settings import NetworkSettings
from pahires.settings import TaskSettings, TemporalSettings


@dataclass(frozen=True)
class PaHiResConfig:
    """The stage `pahires`: its network and its training."""

    network: NetworkSettings = dataclasses.field(default_factory=NetworkSettings)
    training: TemporalSettings = dataclasses.field(default_factory=TemporalSettings)


# All tasks of `motionkit complete`: more frames, gaps filled, frames here and there, the ends continued.
ALL_TASKS = TaskSettings(interpolate=0.45, gap=0.35, scattered=0.1, extend=0.1)


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
    return PaHiResConfig(
        network=NetworkSettings(code=96, hidden=192, decoder_layers=4),
        training=TemporalSettings(
            finer=True,
            # Of two sources of which one has nine times the other's frames, three of four windows and not nine of ten.
            source_evenness=0.5,
            tasks=ALL_TASKS,
            form="exact",
            base="eased",
            sizing="motion",
            blended=("catmull-rom", "linear"),
            balanced=True,
            balance_floor=0.05,
            steps=12_000,
            batch=64,
            rate=1e-3,
            rate_warmup_fraction=0.02,
            ema_decay=0.995,
        ),
    )


def base() -> PaHiResConfig:
    """One GPU of the H100's kind for an hour: `nano` at the paper's widths."""
    training = dataclasses.replace(
        nano().training,
        tasks=dataclasses.replace(ALL_TASKS, num_frames=32, num_queries=32),
        steps=60_000,
        batch=512,
        rate=4e-4,
        ema_decay=0.999,
        precision="auto",
    )
    return PaHiResConfig(network=NetworkSettings(code=256, embedding=128), training=training)


def demo() -> PaHiResConfig:
    """A minute on the embedded corpus: `nano` with fewer steps."""
    return dataclasses.replace(nano(), training=dataclasses.replace(nano().training, steps=600))


RECIPES: dict[str, Callable[[], PaHiResConfig]] = {"nano": nano, "demo": demo, "base": base, "paper": paper}
