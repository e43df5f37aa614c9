"""Number format of matrix products, compiled layers, and the device of a training.

Weights, moments and losses are always float32.
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
        """The requested precision."""
        ...


SettingsT = TypeVar("SettingsT", bound=HasPrecision)


@functools.cache
def has_bfloat16(device: torch.device) -> bool:
    """Whether the CPU has native bfloat16 products; otherwise they are emulated, and slower than float32."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    # torch calls it "avx512_bf16", "amx_bf16" or alike; older versions don't say.
    capabilities: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return device.type == "cpu" and any("bf16" in name and found is True for name, found in capabilities.items())


def with_precision_of(settings: SettingsT, device: torch.device) -> SettingsT:
    """The settings with "auto" replaced by bfloat16 if the device supports it, else by float32.

    So the run's config.json records the choice, and a run is not silently resumed in another precision. Raises
    `UsageError` for unsupported TF32.
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
    """Autocast matrix products inside, and later their gradients, to bfloat16 if that is the precision."""
    chosen = precision == "bfloat16" or (precision == "auto" and has_bfloat16(device))
    return torch.autocast(device.type, torch.bfloat16, enabled=chosen)


@contextmanager
def float32_products(precision: Precision) -> Iterator[None]:
    """Allow or forbid TF32 for float32 products inside, gradients too; a process-wide setting."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high" if precision == "tf32" else "highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def compile_each(layers: Iterable[torch.nn.Module]) -> None:
    """Compile equal layers in place with torch, sharing code; names and values of their tensors are unchanged."""
    for layer in layers:
        layer.compile()


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
