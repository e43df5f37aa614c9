"""The training of any temporal network: one loss and one corpus for all (Eq. 8 to 10)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from motionkit.core.shapes import Float32
from motionkit.core.skeleton import Skeleton
from motionkit.training.loop import Learner, dropout_from
from motionkit.training.networks import autocast
from pahires.temporal.base_curves import interpolated
from pahires.temporal.prediction import Predictor
from pahires.temporal.settings import Distance, TemporalSettings
from pahires.temporal.windows import TrainingBatch, WindowSampler

_Rows = Float32[torch.Tensor, "batch queries numbers"]


class TemporalTraining:
    """A `motionkit.training.loop.Trainable`: a network with its optimiser."""

    def __init__(
        self,
        network: torch.nn.Module,
        sampler: WindowSampler,
        *,
        seed: int,
        device: torch.device,
    ) -> None:
        self.sampler, self.settings, self.device = sampler, sampler.settings, device
        self.network = network.to(device)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0x5CA1E,)))
        self.scaling = sampler.measure(rng)
        settings = self.settings
        # Networks expect standardised rows; see `base_curves`.
        self.predictor = Predictor(network, self.scaling.to(device), settings.answer)
        optimizer = torch.optim.Adam(network.parameters(), lr=settings.schedule.learning_rate)
        self.learner = Learner(network, optimizer, settings.ema_decay)
        self.state_tensors, self.load_state_tensors = self.learner.state_tensors, self.learner.load_state_tensors
        seconds = float(sampler.takes.num_frames.sum()) / float(settings.framerate)
        self.steps = settings.schedule.num_steps(seconds)

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        """One step on a batch of one task."""
        settings = self.settings
        rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
        batch = self.sampler.batch(rng, self.scaling)
        with dropout_from(generator, self.device), autocast(settings.precision, self.device):
            predicted = self.predictor(batch.window.to(self.device))
        targets = batch.targets.to(self.device)
        loss = (self._weights(batch).to(self.device) * self._loss(predicted, targets)).mean()
        rate = settings.schedule.factor(step, self.steps) * settings.schedule.learning_rate
        self.learner.descend(loss, step, rate)
        mse, velocity = losses(predicted.detach(), targets, "squared")
        return {"loss": loss, "mse": mse.mean(), "velocity": velocity.mean()}

    def _weights(self, batch: TrainingBatch) -> Float32[torch.Tensor, "batch"]:
        """Weights of windows: 1, or if `balanced` the inverse of the interpolation's error."""
        if not self.settings.loss.balanced:
            return torch.ones(len(batch.targets))
        curve = interpolated(batch.window, self.settings.answer.base, self.scaling)
        missed = self._loss(curve, batch.targets)
        return 1.0 / (missed + self.settings.loss.balance_floor * missed.mean() + 1e-9)

    def _loss(self, predicted: _Rows, targets: _Rows) -> Float32[torch.Tensor, "batch"]:
        rows, differences = losses(predicted, targets, self.settings.loss.distance)
        return rows + self.settings.loss.velocity_weight * differences


def losses(
    predicted: _Rows, targets: _Rows, distance: Distance
) -> tuple[Float32[torch.Tensor, "batch"], Float32[torch.Tensor, "batch"]]:
    """Mean errors of each window's rows (Eq. 8) and of their differences from frame to frame (Eq. 9)."""
    error = predicted - targets
    measure = torch.square if distance == "squared" else torch.abs
    return measure(error).mean(dim=(1, 2)), measure(error.diff(dim=1)).mean(dim=(1, 2))


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A trained network with everything needed for inference: scaling, form of the output, the skeleton's joints."""

    name: str
    predictor: Predictor
    settings: TemporalSettings
    skeleton: Skeleton

    @property
    def spacing_seconds(self) -> float:
        """Spacing of the queried frames in training, in seconds: the networks' target spacing."""
        return 1.0 / float(self.settings.framerate)

    @property
    def reach_seconds(self) -> float:
        """The longest extrapolation in training; 0 without extrapolation."""
        tasks = self.settings.tasks
        return tasks.longest_reach * self.spacing_seconds if tasks.extend > 0 else 0.0

    @property
    def longest_gap_seconds(self) -> float:
        """The longest time between neighbouring observed frames in training."""
        tasks = self.settings.tasks
        longest = max(np.ceil(tasks.largest_factor), tasks.longest_gap + 1 if tasks.gap > 0 else 0)
        return float(longest) * self.spacing_seconds
