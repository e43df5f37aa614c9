"""Tensors in files: safetensors with a JSON description in the header, written atomically, no pickle."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
import torch
from safetensors.torch import save_file

from motionkit.errors import MotionkitError


class CheckpointError(MotionkitError):
    """A checkpoint that is missing, damaged, or of another model."""


def save_tensors(path: Path, tensors: Mapping[str, torch.Tensor], description: Mapping[str, Any]) -> None:
    """Write tensors and a JSON description into one file, which appears whole or not at all.

    The description travels in the safetensors header, so that tensors and their meaning are one atomic rename.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    plain = {name: tensor.detach().to("cpu").contiguous().clone() for name, tensor in tensors.items()}
    try:
        save_file(plain, temporary, metadata={"description": json.dumps(dict(description), allow_nan=False)})
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def load_tensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read a file of `save_tensors`: tensors on the CPU, and the description.

    Raises `CheckpointError` for a file that is absent or that safetensors can't read.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such checkpoint")
    try:
        with safetensors.safe_open(path, framework="pt") as opened:
            description = json.loads((opened.metadata() or {}).get("description", "{}"))
            return {name: opened.get_tensor(name) for name in opened.keys()}, description  # noqa: SIM118
    except (safetensors.SafetensorError, ValueError) as error:
        raise CheckpointError(f"{path}: not a whole safetensors file ({one_line(error)})") from None


def one_line(error: Exception, longest: int = 200) -> str:
    """What an error says, on one line and no longer than a person reads."""
    said = " ".join(str(error).split()) or type(error).__name__
    return said if len(said) <= longest else f"{said[:longest]} …"


def prefixed(prefix: str, tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The same tensors under `prefix.name`."""
    return {f"{prefix}.{name}": tensor for name, tensor in tensors.items()}


def unprefixed(prefix: str, tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Those tensors whose name starts with `prefix.`, without it."""
    return {
        name.removeprefix(f"{prefix}."): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}.")
    }


def optimizer_tensors(optimizer: torch.optim.Optimizer) -> dict[str, torch.Tensor]:
    """The state of a torch optimiser (moments, step counts) as named tensors."""
    return {
        f"{index}.{name}": torch.as_tensor(value)
        for index, state in optimizer.state_dict()["state"].items()
        for name, value in state.items()
    }


def load_optimizer_tensors(optimizer: torch.optim.Optimizer, tensors: Mapping[str, torch.Tensor]) -> None:
    """Put the state of `optimizer_tensors` back; the optimiser's own parameter groups stay as they are."""
    state: dict[int, dict[str, torch.Tensor]] = {}
    for name, tensor in tensors.items():
        index, _, key = name.partition(".")
        state.setdefault(int(index), {})[key] = tensor
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
