"""Learning rates of optimisers, weight averages, and seeded randomness of each step."""

import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import torch


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
        """Update the average with the module's weights after `step` (0-based)."""
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
        """Restore averages."""
        for name, average in self.averages.items():
            average.copy_(tensors[name])


def _state(seed: int, purpose: str, step: int) -> int:
    sequence = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()), step))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def step_generator(seed: int, purpose: str, step: int = 0) -> torch.Generator:
    """A CPU generator for one step of one purpose; drawing on the CPU gives every device the same numbers."""
    return torch.Generator().manual_seed(_state(seed, purpose, step))


@contextmanager
def seeded_initialisation(seed: int, purpose: str) -> Iterator[None]:
    """Initialise modules inside from (seed, purpose); torch's global generator is restored."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(_state(seed, purpose, 0))
        yield


@contextmanager
def dropout_from(generator: torch.Generator, device: torch.device, rank: int = 0) -> Iterator[None]:
    """Seed dropout inside by the generator and the rank; torch's global generators are restored."""
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.manual_seed(int(torch.randint(2**62, (), generator=generator)) + rank)
        yield
