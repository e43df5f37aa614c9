"""How and where a training computes: the number format of matrix products, compiled layers, the device.

Weights, moments and losses are float32 in any case.
"""

import dataclasses
import functools
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Protocol, TypeVar, runtime_checkable

import torch

from motionkit.core.errors import UsageError
from motionkit.training.config import ConfigLike, Precision


@runtime_checkable
class HasPrecision(ConfigLike, Protocol):
    """Settings, a dataclass, with a precision among them."""

    @property
    def precision(self) -> Precision:
        """What was asked for."""
        ...


SettingsT = TypeVar("SettingsT", bound=HasPrecision)


@functools.cache
def has_bfloat16(device: torch.device) -> bool:
    """Whether the processor multiplies bfloat16 itself; elsewhere it is emulated, and slower than float32."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    # torch calls it "avx512_bf16", "amx_bf16" or alike; older versions don't say.
    capabilities: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return device.type == "cpu" and any("bf16" in name and found is True for name, found in capabilities.items())


def with_precision_of(settings: SettingsT, device: torch.device) -> SettingsT:
    """The settings with "auto" replaced by bfloat16 where the device has it, else by float32.

    What was chosen is thus written into the run's config.json, and a run is not resumed in another precision unseen.
    Raises `UsageError` for TF32 where there is none.
    """
    if settings.precision == "tf32" and not (
        device.type == "cuda" and torch.cuda.get_device_capability(device) >= (8, 0)
    ):
        raise UsageError(f"{device} has no TF32 (NVIDIA GPUs from Ampere on have): precision=auto, or float32")
    if settings.precision != "auto":
        return settings
    chosen = "bfloat16" if has_bfloat16(device) else "float32"
    return dataclasses.replace(settings, precision=chosen)


def autocast(precision: Precision, device: torch.device) -> AbstractContextManager[None]:
    """Matrix products inside, and later their gradients, are computed in bfloat16 where that is the precision."""
    chosen = precision == "bfloat16" or (precision == "auto" and has_bfloat16(device))
    return torch.autocast(device.type, torch.bfloat16, enabled=chosen)


@contextmanager
def float32_products(precision: Precision) -> Iterator[None]:
    """Whether float32 products inside, gradients too, may be TF32's; it is a setting of the whole process."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high" if precision == "tf32" else "highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def compile_each(layers: Iterable[torch.nn.Module]) -> None:
    """Let torch compile equal layers in place, one of them for all; names and values of their tensors stay."""
    for layer in layers:
        layer.compile()


def resolve_device(name: str) -> torch.device:
    """The device a user named; "auto" is the first CUDA device, else the CPU.

    Raises `UsageError` for a name torch doesn't know or a device that isn't there.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"--device {name}: {str(error).splitlines()[0]}") from None
    return device
