"""Learning rates as functions of the step, and averages of weights."""

import math
from collections.abc import Mapping
from typing import Literal

import torch

ScheduleName = Literal["constant", "cosine"]


def rate_factor(step: int, steps: int, *, schedule: ScheduleName, warmup_fraction: float = 0.0) -> float:
    """What to multiply a base learning rate by at a step: linear warm-up, then constant or half a cosine to 0."""
    warmup_steps = round(warmup_fraction * steps)
    if step < warmup_steps:
        return (step + 1) / warmup_steps
    if schedule == "constant":
        return 1.0
    return 0.5 * (1.0 + math.cos(math.pi * (step - warmup_steps) / max(1, steps - warmup_steps)))


def set_rate(optimizer: torch.optim.Optimizer, rate: float) -> None:
    """Set the learning rate of every parameter group."""
    for group in optimizer.param_groups:
        group["lr"] = rate


def scale_rates(optimizer: torch.optim.Optimizer, factor: float) -> None:
    """Set every parameter group's learning rate to its own `base_lr` times a factor."""
    for group in optimizer.param_groups:
        group["lr"] = group["base_lr"] * factor


class WeightAverage:
    """Exponential moving average of a module's parameters; buffers are copied.

    The decay ramps up as min(decay, (1 + n) / (10 + n)) over updates n, so that early averages forget the start.
    """

    def __init__(self, module: torch.nn.Module, decay: float) -> None:
        self.decay = decay
        self.averages = {name: tensor.detach().clone() for name, tensor in module.state_dict().items()}

    @torch.no_grad()
    def update(self, module: torch.nn.Module, step: int) -> None:
        """Take in the module's weights after `step` (0-based)."""
        weight = 1.0 - min(self.decay, (1.0 + step) / (10.0 + step))
        for name, tensor in module.state_dict().items():
            if tensor.is_floating_point():
                self.averages[name].lerp_(tensor, weight)
            else:
                self.averages[name].copy_(tensor)

    def tensors(self) -> dict[str, torch.Tensor]:
        """The averages by the module's own names."""
        return dict(self.averages)

    def load(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Put averages back."""
        for name, average in self.averages.items():
            average.copy_(tensors[name])
