"""Randomness that depends on (seed, purpose, step) alone, so that resuming needs no generator state."""

import zlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


def _state(seed: int, purpose: str, step: int) -> int:
    sequence = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()), step))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def step_generator(seed: int, purpose: str, step: int = 0) -> torch.Generator:
    """A CPU generator for one step of one purpose; drawing on the CPU gives every device the same numbers."""
    return torch.Generator().manual_seed(_state(seed, purpose, step))


@contextmanager
def seeded_initialisation(seed: int, purpose: str) -> Iterator[None]:
    """Modules made inside draw their weights from (seed, purpose); torch's global generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(_state(seed, purpose, 0))
        yield


@contextmanager
def dropout_from(generator: torch.Generator, device: torch.device, rank: int = 0) -> Iterator[None]:
    """Dropout inside follows from the generator and the rank; torch's global generators are left as they were."""
    with torch.random.fork_rng(devices=[device] if device.type == "cuda" else []):
        torch.manual_seed(int(torch.randint(2**62, (), generator=generator)) + rank)
        yield
