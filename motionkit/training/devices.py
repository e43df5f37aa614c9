"""Devices, number formats and processes of a training.

Weights, moments and losses are always float32; matrix products may be bfloat16.

Distributed data-parallel training: `torchrun` starts the processes and sets their environment variables. A batch does
not depend on the number of ranks: every rank draws all of it (from the same generator), computes its own rows, and
results are summed. So N ranks follow one rank's losses up to the order of floating-point sums, and a checkpoint can be
resumed with another number of ranks. With one rank, all of this does nothing.
"""

import functools
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any

import numpy as np
import torch
from torch import distributed

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Int64, Shaped
from motionkit.training.config import ConfigT, Precision

# A rank may wait for long while the first one trains a stage alone; torchrun ends all ranks if one dies.
PATIENCE = timedelta(days=7)


@dataclass(frozen=True)
class Ranks:
    """This process' rank among `size`."""

    rank: int = 0
    size: int = 1

    @property
    def is_first(self) -> bool:
        """Whether this is the rank that prints and writes."""
        return self.rank == 0

    def rows_of(self, count: int) -> slice:
        """This rank's share of `count` rows: shares are contiguous, in order of ranks, and differ by at most one.

        Raises `UsageError` if a rank would have none.
        """
        if count < self.size:
            raise UsageError(f"a batch of {count} can't be shared by {self.size} ranks")
        return slice(count * self.rank // self.size, count * (self.rank + 1) // self.size)

    def add_up(self, tensors: Iterable[torch.Tensor]) -> None:
        """All-reduce (sum) tensors of one type on one device in place, in a single message."""
        own = list(tensors)
        if self.size == 1 or not own:
            return
        message = torch.cat([tensor.detach().flatten() for tensor in own])
        distributed.all_reduce(message)
        for tensor, total in zip(own, torch.split(message, [tensor.numel() for tensor in own]), strict=True):
            tensor.detach().copy_(total.view_as(tensor))

    def all_rows(self, own: Shaped[torch.Tensor, "own *rest"], count: int) -> Shaped[torch.Tensor, "count *rest"]:
        """Gather the rows of all ranks, of which each has its `rows_of(count)`."""
        if self.size == 1:
            return own
        rows = own.new_zeros((count, *own.shape[1:]))
        rows[self.rows_of(count)] = own
        self.add_up([rows])
        return rows

    def agree(self, *flags: bool) -> tuple[bool, ...]:
        """For each flag, whether it is true on any rank."""
        if self.size == 1:
            return flags
        raised = torch.tensor(flags, dtype=torch.int32)
        distributed.all_reduce(raised, distributed.ReduceOp.MAX)
        return tuple(bool(flag) for flag in raised)

    def wait(self) -> None:
        """Barrier: wait for all ranks."""
        self.agree(False)

    def on_first(self, action: Callable[[], object]) -> None:
        """Call a function on the first rank while the others wait; if it raises, the others exit silently."""
        failed = True
        try:
            if self.is_first:
                action()
            failed = False
        finally:
            (any_failed,) = self.agree(failed)
        if any_failed:
            raise SystemExit(1)


ALONE = Ranks()


def present_ranks() -> Ranks:
    """The ranks that this process has joined, or a single one."""
    if distributed.is_available() and distributed.is_initialized():
        return Ranks(distributed.get_rank(), distributed.get_world_size())
    return ALONE


@contextmanager
def joined_ranks() -> Iterator[Ranks]:
    """Join the process group of torchrun's environment; does nothing without torchrun, or with one process.

    The backend is NCCL for GPUs and Gloo for CPUs; "cuda" then is the GPU of this rank.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield ALONE
        return
    backend = "gloo"
    if torch.cuda.is_available():
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")) % torch.cuda.device_count())
        backend = "cpu:gloo,cuda:nccl"
    distributed.init_process_group(backend, timeout=PATIENCE)
    try:
        yield present_ranks()
    finally:
        distributed.destroy_process_group()


class DealtRows:
    """Partition of a table's rows, such as latents, over ranks.

    Each rank has consecutive rows in a given order, of about the same total weight.
    """

    def __init__(self, ranks: Ranks, weight: Float[np.ndarray, "rows"], order: Int64[np.ndarray, "rows"]) -> None:
        self.ranks = ranks
        before = np.cumsum(weight[order]) - 0.5 * weight[order]
        owner = np.empty(len(order), dtype=np.int64)
        owner[order] = np.minimum(ranks.size * before / weight.sum(), ranks.size - 1).astype(np.int64)
        self.owner = torch.from_numpy(owner)
        self.rows = torch.nonzero(self.owner == ranks.rank)[:, 0]

    def mine(self, rows: Int64[torch.Tensor, "batch"]) -> Int64[torch.Tensor, "mine"]:
        """Positions in a batch of the rows that this rank owns."""
        return torch.nonzero(self.owner[rows] == self.ranks.rank)[:, 0]

    def place(self, rows: Int64[torch.Tensor, "mine"]) -> Int64[torch.Tensor, "mine"]:
        """Indices in this rank's own table of rows that it owns."""
        return torch.searchsorted(self.rows, rows)

    def gather(self, table: Shaped[torch.Tensor, "own *rest"]) -> Shaped[torch.Tensor, "all *rest"]:
        """Gather the whole table on the CPU of the first rank; the others get an empty one."""
        table = table.detach().cpu()
        if self.ranks.size == 1:
            return table
        if not self.ranks.is_first:
            distributed.send(table.contiguous(), dst=0)
            return table[:0]
        whole = table.new_empty((len(self.owner), *table.shape[1:]))
        whole[self.rows] = table
        for rank in range(1, self.ranks.size):
            rows = torch.nonzero(self.owner == rank)[:, 0]
            received = table.new_empty((len(rows), *table.shape[1:]))
            distributed.recv(received, src=rank)
            whole[rows] = received
        return whole


@functools.cache
def has_bfloat16(device: torch.device) -> bool:
    """Whether the CPU has native bfloat16 products; otherwise they are emulated, and slower than float32."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    # torch calls it "avx512_bf16", "amx_bf16" or alike; older versions don't say.
    capabilities: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return device.type == "cpu" and any("bf16" in name and value is True for name, value in capabilities.items())


def with_precision_of(settings: ConfigT, device: torch.device) -> ConfigT:
    """The settings with `precision` "auto" replaced by bfloat16 if the device supports it, else by float32.

    So the run's config.json records the choice, and a run is not silently resumed in another precision.
    """
    precision: Precision = vars(settings)["precision"]
    if precision != "auto":
        return settings
    chosen = "bfloat16" if has_bfloat16(device) else "float32"
    return replace(settings, precision=chosen)


def autocast(precision: Precision, device: torch.device) -> AbstractContextManager[None]:
    """Autocast matrix products inside, and later their gradients, to bfloat16 if that is the precision."""
    chosen = precision == "bfloat16" or (precision == "auto" and has_bfloat16(device))
    return torch.autocast(device.type, torch.bfloat16, enabled=chosen)


def resolve_device(name: str) -> torch.device:
    """The device a user named; "auto" is the first CUDA device, else the CPU.

    Raises `UsageError` for an unknown name or a missing device.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"--device {name}: {str(error).splitlines()[0]}") from None
    return device
