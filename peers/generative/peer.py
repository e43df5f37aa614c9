"""A generative peer: its training stages in order, each with its network and recipes. Imports nothing heavy."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, make_dataclass
from functools import cached_property, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from motionkit.training.config import Precision, Schedule
from peers.generative.settings import ConditionsConfig, MotionsConfig, OptimizerConfig

if TYPE_CHECKING:
    import torch

    from peers.generative.batches import ConditionSizes, PoseSpace


@dataclass(frozen=True)
class PeerStage:
    """One training stage: `network` is "module:Class", `recipes` the parts of its configuration by recipe and name.

    `share` is its share of the peer's time budget, relative to the other stages.
    """

    name: str
    order: int
    description: str
    network: str
    recipes: Mapping[str, Mapping[str, Any]]
    builds_on: tuple[str, ...] = ()
    share: float = 1.0

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
        """Build the network, initialised by torch's global generator."""
        module, _, name = self.network.partition(":")
        made: torch.nn.Module = getattr(import_module(module), name)(config.network, space, sizes, earlier)
        return made


@dataclass(frozen=True)
class GenerativePeer:
    """A published system: `title` names its rows in tables; the last of its stages generates.

    If not `conditional`, it takes no text and no action, whatever it is trained on.
    """

    title: str
    stages: tuple[PeerStage, ...]
    conditional: bool = True


def stage_named(peer: GenerativePeer, name: str) -> PeerStage:
    """The stage of this name."""
    return next(stage for stage in peer.stages if stage.name == name)
