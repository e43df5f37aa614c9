"""The training of any temporal network: one loop, one loss, one corpus, whatever the network (Eq. 8 to 10)."""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float32

from motionkit.clips.temporal.base_curves import interpolated
from motionkit.clips.temporal.prediction import Predictor
from motionkit.clips.temporal.settings import Distance
from motionkit.clips.temporal.windows import TrainingBatch, WindowSampler
from motionkit.training.precision import autocast
from motionkit.training.schedule import WeightAverage, dropout_from, scale_rates
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
        self.predictor = Predictor(network, self.scaling.to(device), settings.answer)
        rate = settings.schedule.learning_rate
        self.optimizer = torch.optim.Adam([{"params": list(network.parameters()), "base_lr": rate}])
        self.average = WeightAverage(network, settings.ema_decay) if settings.ema_decay else None
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
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        scale_rates(self.optimizer, settings.schedule.factor(step, self.steps))
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

    def _weights(self, batch: TrainingBatch) -> Float32[torch.Tensor, "batch"]:
        """1 for every window, or where they are `balanced` the inverse of what the interpolation misses of each."""
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
