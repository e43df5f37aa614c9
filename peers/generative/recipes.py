"""The generative peers: a row each with its stages, their networks and recipes. Imports nothing heavy.

`paper` has each one's published sizes, batch and steps; `nano` small networks for about the processor time of NeRM's
nano, 18 minutes of one core for all stages together.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, make_dataclass, replace
from functools import cached_property, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from motionkit.training.config import Precision, Schedule
from peers.generative.settings import (
    ConditionsConfig,
    MdmNetworkConfig,
    MldNetworkConfig,
    MldVaeNetworkConfig,
    MotionsConfig,
    OptimizerConfig,
    TransformerSizes,
)

if TYPE_CHECKING:
    import torch

    from peers.generative.batches import ConditionSizes, PoseSpace


@dataclass(frozen=True)
class PeerStage:
    """One training: `network` is "module:Class", `recipes` the parts of its configuration by recipe and name."""

    name: str
    order: int
    description: str
    network: str
    recipes: Mapping[str, Mapping[str, Any]]
    builds_on: tuple[str, ...] = ()

    @cached_property
    def config_type(self) -> type[Any]:
        """The stage's configuration (`peers.generative.settings.PeerConfig`)."""
        sizes = type(self.recipes["paper"]["network"])
        parts: list[tuple[str, Any, Any]] = [
            ("network", sizes, field(default_factory=sizes)),
            ("motions", MotionsConfig, field(default_factory=MotionsConfig)),
            ("conditions", ConditionsConfig, field(default_factory=ConditionsConfig)),
            ("schedule", Schedule, field(default_factory=partial(Schedule, epochs=1))),
            ("optimizer", OptimizerConfig, field(default_factory=OptimizerConfig)),
            ("precision", Precision, field(default="float32")),
        ]
        return make_dataclass(sizes.__name__.replace("Network", ""), parts, frozen=True)

    @property
    def configs(self) -> dict[str, Callable[[], Any]]:
        """The recipes as functions that make their configurations."""
        make: Callable[..., Any] = self.config_type
        return {name: partial(make, **parts) for name, parts in self.recipes.items()}

    def make_network(
        self, config: Any, space: "PoseSpace", sizes: "ConditionSizes", earlier: "Mapping[str, torch.nn.Module]"
    ) -> "torch.nn.Module":
        """The network, its weights drawn from torch's generator."""
        module, _, name = self.network.partition(":")
        made: torch.nn.Module = getattr(import_module(module), name)(config.network, space, sizes, earlier)
        return made


@dataclass(frozen=True)
class GenerativePeer:
    """A published system: `title` names its rows in tables; the last of its stages generates."""

    title: str
    stages: tuple[PeerStage, ...]


def stage_named(peer: GenerativePeer, name: str) -> PeerStage:
    """One of a peer's stages."""
    return next(stage for stage in peer.stages if stage.name == name)


MINILM = ConditionsConfig(text_encoder="minilm", scaled=True)
SMALL = TransformerSizes(4, 128, 4, 256)
MDM_PAPER = {"network": MdmNetworkConfig(), "schedule": Schedule(steps=600_000)}
MDM_NANO = {
    "network": MdmNetworkConfig(SMALL),
    "conditions": MINILM,
    "schedule": Schedule(steps=1800, batch_size=32, learning_rate=1e-3, kind="cosine", warmup_fraction=0.02),
    "optimizer": OptimizerConfig(ema_decay=0.995),
    "precision": "auto",
}


def _in_50_steps(parts: Mapping[str, Any], ema_decay: float) -> dict[str, Any]:
    """The same training of a process of 50 steps."""
    diffusion = replace(parts["network"].diffusion, num_steps=50, sampling_steps=50)
    network = replace(parts["network"], diffusion=diffusion)
    return {**parts, "network": network, "optimizer": OptimizerConfig(ema_decay=ema_decay)}


MDM = GenerativePeer(
    "MDM",
    (
        PeerStage(
            "mdm",
            80,
            "MDM: diffusion of whole motions in 1,000 steps (NeRM's peer)",
            "peers.generative.mdm:Mdm",
            {"nano": MDM_NANO, "paper": MDM_PAPER},
        ),
    ),
)
MDM_50 = GenerativePeer(
    "MDM, 50 steps",
    (
        PeerStage(
            "mdm-50",
            81,
            "MDM trained with 50 diffusion steps",
            "peers.generative.mdm:Mdm",
            {"nano": _in_50_steps(MDM_NANO, 0.995), "paper": _in_50_steps(MDM_PAPER, 0.9999)},
        ),
    ),
)
SMALL_SKIPS = TransformerSizes(5, 128, 4, 256)
MLD_TEXTS = ConditionsConfig(nothing="empty")
MLD = GenerativePeer(
    "MLD",
    (
        PeerStage(
            "mld-vae",
            82,
            "MLD, stage 1: a VAE of whole motions",
            "peers.generative.mld:MldVae",
            {
                "nano": {
                    "network": MldVaeNetworkConfig(replace(SMALL_SKIPS, dropout=0.0)),
                    "conditions": ConditionsConfig(kind="none"),
                    "schedule": Schedule(
                        steps=600, batch_size=32, learning_rate=5e-4, kind="cosine", warmup_fraction=0.1
                    ),
                    "precision": "auto",
                },
                "paper": {
                    "network": MldVaeNetworkConfig(),
                    "conditions": ConditionsConfig(kind="none"),
                    "schedule": Schedule(epochs=6000, batch_size=128),
                    "optimizer": OptimizerConfig(weight_decay=0.01),
                },
            },
        ),
        PeerStage(
            "mld",
            83,
            "MLD, stage 2: diffusion of the VAE's latents",
            "peers.generative.mld:Mld",
            {
                "nano": {
                    "network": MldNetworkConfig(replace(SMALL_SKIPS, dropout=0.0), time_features=128),
                    "conditions": replace(MINILM, nothing="empty"),
                    "schedule": Schedule(
                        steps=1500, batch_size=64, learning_rate=1e-3, kind="cosine", warmup_fraction=0.02
                    ),
                    "optimizer": OptimizerConfig(ema_decay=0.995),
                    "precision": "auto",
                },
                "paper": {
                    "network": MldNetworkConfig(),
                    "conditions": MLD_TEXTS,
                    "schedule": Schedule(epochs=2000),
                    "optimizer": OptimizerConfig(weight_decay=0.01),
                },
            },
            builds_on=("mld-vae",),
        ),
    ),
)
PEERS = (MDM, MDM_50, MLD)
