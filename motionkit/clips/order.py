"""The order in which a training goes through its windows: a function of the seed and the step alone."""

from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Int64

from motionkit.clips.windows import Windows


def rows_by_duration(windows: Windows, seconds_per_visit: float) -> Int64[np.ndarray, "visits"]:
    """Each window as often as it lasts `seconds_per_visit`, once at least: what an epoch goes through."""
    visits = np.maximum(1, np.round(windows.duration_seconds / seconds_per_visit)).astype(np.int64)
    return np.repeat(np.arange(len(windows)), visits)


def shuffled_batches(count: int, batch: int, step: int, seed: int) -> Int64[torch.Tensor, "batch"]:
    """The rows of batch number `step`, when `count` rows are gone through again and again in a new order each time.

    A function of (seed, step) alone, so that a resumed training sees the same batches.
    """
    first = step * batch
    epochs = range(first // count, (first + batch - 1) // count + 1)
    rows = torch.cat([_permutation(count, seed, epoch) for epoch in epochs])
    offset = first - epochs[0] * count
    return rows[offset : offset + batch]


def _permutation(count: int, seed: int, epoch: int) -> Int64[torch.Tensor, "rows"]:
    order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(epoch,))).permutation(count)
    return torch.from_numpy(order.astype(np.int64))


def chunks(count: int, size: int) -> Iterator[Int64[np.ndarray, "rows"]]:
    """Rows 0 … count − 1 in chunks of at most `size`."""
    for start in range(0, count, size):
        yield np.arange(start, min(start + size, count), dtype=np.int64)
