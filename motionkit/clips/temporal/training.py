"""The training of any temporal network: one loop, one loss, one corpus, whatever the network (Eq. 8 to 10)."""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float32

from motionkit.clips.temporal.base_curves import interpolated
from motionkit.clips.temporal.prediction import predictor_of
from motionkit.clips.temporal.settings import Distance, TemporalSettings
from motionkit.clips.temporal.windows import TrainingBatch, WindowSampler
from motionkit.training.precision import autocast
from motionkit.training.schedule import WeightAverage, dropout_from, rate_factor, scale_rates
from motionkit.training.tensors import load_optimizer_tensors, optimizer_tensors, prefixed, unprefixed

_Rows = Float32[torch.Tensor, "batch queries numbers"]


class TemporalTraining:
    """A network with its optimiser: what `train_loop` steps."""

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
        # What a network meets when it is made is standardised rows of the corpus; see `base_curves`.
        self.predictor = predictor_of(network, self.scaling.to(device), settings)
        self.optimizer = torch.optim.Adam([{"params": list(network.parameters()), "base_lr": settings.rate}])
        self.average = WeightAverage(network, settings.ema_decay) if settings.ema_decay else None
        self.steps = num_steps(settings, sampler)

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        """One step on a batch of one task."""
        settings = self.settings
        rng = np.random.default_rng(int(torch.randint(2**62, (), generator=generator)))
        batch = self.sampler.batch(rng, self.scaling)
        with dropout_from(generator, self.device), autocast(settings.precision, self.device):
            predicted = self.predictor(batch.window.to(self.device))
        targets = batch.targets.to(self.device)
        loss = (self._weights(batch).to(self.device) * self._loss(predicted, targets)).mean()
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        scale_rates(self.optimizer, self._factor(step))
        self.optimizer.step()
        if self.average is not None:
            self.average.update(self.network, step)
        mse, velocity = losses(predicted.detach(), targets, "squared")
        return {"loss": loss, "mse": mse.mean(), "velocity": velocity.mean()}

    def trained_tensors(self) -> dict[str, torch.Tensor]:
        """The weights to keep: their average where there is one."""
        return self.network.state_dict() if self.average is None else self.average.tensors()

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """Weights, moments and averages."""
        average = {} if self.average is None else prefixed("average", self.average.tensors())
        return (
            prefixed("network", self.network.state_dict())
            | prefixed("optimizer", optimizer_tensors(self.optimizer))
            | average
        )

    def load_state_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Go back to a state."""
        self.network.load_state_dict(unprefixed("network", tensors))
        load_optimizer_tensors(self.optimizer, unprefixed("optimizer", tensors))
        if self.average is not None:
            self.average.load(unprefixed("average", tensors))

    def _factor(self, step: int) -> float:
        settings = self.settings
        if settings.schedule != "steps":
            return rate_factor(
                step, self.steps, schedule=settings.schedule, warmup_fraction=settings.rate_warmup_fraction
            )
        return float(settings.rate_drop ** int(step / (settings.drop_every * self.steps)))

    def _weights(self, batch: TrainingBatch) -> Float32[torch.Tensor, "batch"]:
        """1 for every window, or where they are `balanced` the inverse of what the interpolation misses of each."""
        if not self.settings.balanced:
            return torch.ones(len(batch.targets))
        curve = interpolated(batch.window, self.settings.base, self.scaling)
        missed = self._loss(curve, batch.targets)
        return 1.0 / (missed + self.settings.balance_floor * missed.mean() + 1e-9)

    def _loss(self, predicted: _Rows, targets: _Rows) -> Float32[torch.Tensor, "batch"]:
        rows, differences = losses(predicted, targets, self.settings.distance)
        return rows + self.settings.velocity_weight * differences


def losses(
    predicted: _Rows, targets: _Rows, distance: Distance
) -> tuple[Float32[torch.Tensor, "batch"], Float32[torch.Tensor, "batch"]]:
    """Mean errors of each window's rows (Eq. 8) and of their differences from frame to frame (Eq. 9)."""
    error = predicted - targets
    measure = torch.square if distance == "squared" else torch.abs
    return measure(error).mean(dim=(1, 2)), measure(error.diff(dim=1)).mean(dim=(1, 2))


def num_steps(settings: TemporalSettings, sampler: WindowSampler) -> int:
    """Training steps: `steps`, or epochs in which every second of the corpus is the start of a window once."""
    if settings.steps is not None:
        return settings.steps
    assert settings.epochs is not None
    seconds = float(sampler.takes.num_frames.sum()) / float(settings.framerate)
    return max(1, int(np.ceil(settings.epochs * seconds / settings.batch)))
