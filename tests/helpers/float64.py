"""Torch in float64, whose sums differ between processors by some 1e-14; those of float32 differ by 1e-4 and more."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import jaxtyping
import numpy as np
import torch
from torch.overrides import TorchFunctionMode


class _Float64(TorchFunctionMode):
    """Torch's functions make float64 where float32 is named."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        func = torch.Tensor.double if func is torch.Tensor.float else func
        return func(*map(_doubled, args), **{name: _doubled(value) for name, value in (kwargs or {}).items()})


def _doubled(value: Any) -> Any:
    return torch.float64 if value is torch.float32 else value


@contextmanager
def float64_on_one_thread() -> Iterator[None]:
    """Everything inside, arrays of float32 that are made tensors too; annotations of float32 are not checked."""
    threads, from_numpy = torch.get_num_threads(), torch.from_numpy

    def from_array(array: np.ndarray) -> torch.Tensor:
        return from_numpy(array.astype(np.float64) if array.dtype == np.float32 else array)

    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        with patch.object(torch, "from_numpy", from_array), _Float64():
            yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)
        torch.set_default_dtype(torch.float32)
        torch.set_num_threads(threads)
