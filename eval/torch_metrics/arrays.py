"""Conversion of a metric's states, tensors on a device, to the arrays that the functions of `eval.metrics` take."""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torchmetrics.utilities import dim_zero_cat


def array_of(values: Tensor | npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Values as an array; half-precision types, which numpy lacks in part, become float32, exactly."""
    if not isinstance(values, Tensor):
        return np.asarray(values)
    if values.is_floating_point() and values.dtype not in (torch.float32, torch.float64):
        values = values.float()
    array: npt.NDArray[Any] = values.detach().cpu().numpy()
    return array


def rows_of(state: list[Tensor] | Tensor, what: str) -> npt.NDArray[Any]:
    """All rows of a list state, including those of other processes. Raises `ValueError` if there are none."""
    if not len(state):
        raise ValueError(f"there are no {what}: call update first")
    return array_of(dim_zero_cat(state))
