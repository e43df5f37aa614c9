"""A temporal network of a few thousand numbers for the tests of all that lies outside of networks."""

from dataclasses import dataclass, field
from pathlib import Path

import torch

from motionkit.training.config import apply_overrides
from motionkit.training.run import RunFolder, StageContext
from pahires.temporal.base_curves import located, seconds_beyond
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import TaskSettings, TemporalConfig, TemporalSettings
from pahires.temporal.system import TemporalSystem
from pahires.temporal.training import TrainedNetwork
from tests.helpers.tiny import write_store

TASKS = TaskSettings(
    interpolate=2.0,
    gap=1.0,
    scattered=1.0,
    extend=1.0,
    num_frames=6,
    past_frames=4,
    future_frames=3,
    longest_gap=9,
    longest_reach=8,
    num_queries=8,
)


@dataclass(frozen=True)
class SmallConfig(TemporalConfig):
    network: int = 32
    training: TemporalSettings = field(
        default_factory=lambda: apply_overrides(
            TemporalSettings(tasks=TASKS, mirrored=False),
            ["schedule.steps=30", "schedule.batch_size=8", "schedule.learning_rate=0.003"],
        )
    )


class SmallNetwork(torch.nn.Module):
    """The frames on both sides of a query, the fraction between them and the seconds beyond: an MLP."""

    def __init__(self, num_features: int, width: int) -> None:
        super().__init__()
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(2 * num_features + 2, width), torch.nn.SiLU(), torch.nn.Linear(width, num_features)
        )

    def forward(self, window: ObservedWindow) -> torch.Tensor:
        segment, fraction = located(window)
        rows = torch.arange(len(segment))[:, None]
        following = (segment + 1).clamp(max=window.frames.shape[1] - 1)
        times = torch.stack((fraction, seconds_beyond(window)), dim=-1)
        answer: torch.Tensor = self.layers(
            torch.cat((window.frames[rows, segment], window.frames[rows, following], times), dim=-1)
        )
        return answer


SYSTEM = TemporalSystem(
    "small", "", SmallConfig, lambda config, num_features: SmallNetwork(num_features, config.network), {}
)


def train(folder: Path, config: SmallConfig, *, resume: bool = False) -> RunFolder:
    """Train on a corpus of seconds, which is made where it is missing."""
    store = folder / "store"
    if not store.exists():
        write_store(store)
    run = RunFolder(folder / "run")
    context = StageContext(store, run, "tiny", seed=3, resume=resume, device="cpu")
    SYSTEM.train(context, config)
    return run


def load(run: RunFolder) -> TrainedNetwork:
    return SYSTEM.load_network(run.path, "Small")
