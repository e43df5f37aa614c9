"""Checkpoints that other projects saved with torch: read without running their pickle, checked tensor by tensor."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from motionkit.training.tensors import CheckpointError

LARGEST_BYTES = 4 << 30


def read_foreign(path: Path) -> dict[str, Any]:
    """What the file holds by name, tensors on the CPU.

    Raises `CheckpointError` for a file that is absent, implausibly large, damaged, or that could only be read by
    running the code in it (`weights_only=True` refuses).
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such file")
    if path.stat().st_size > LARGEST_BYTES:
        raise CheckpointError(f"{path}: {path.stat().st_size:,} bytes, more than any checkpoint that is read here")
    try:
        loaded: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        # torch reports damage, foreign files and forbidden objects by half a dozen classes.
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise CheckpointError(
            f"{path}: not a checkpoint that can be read without running its pickle ({reason})"
        ) from None
    return {str(name): value for name, value in loaded.items()} if isinstance(loaded, dict) else {}


def foreign_tensors(loaded: Mapping[str, Any], key: str, path: Path, what: str) -> dict[str, torch.Tensor]:
    """The named tensors under one key of a checkpoint; raises `CheckpointError` where there are none."""
    tensors = loaded.get(key)
    if not isinstance(tensors, dict) or not all(isinstance(tensor, torch.Tensor) for tensor in tensors.values()):
        raise CheckpointError(f"{path}: not {what}, whose checkpoint has its tensors under the key {key!r}")
    return {str(name): tensor for name, tensor in tensors.items()}


def fill_checked(
    own: Mapping[str, torch.Tensor], found: Mapping[str, torch.Tensor], key: str, path: Path, what: str
) -> None:
    """Copy `found` into `own`, in place, after checking that names, shapes and finiteness are right.

    Raises `CheckpointError` that names the tensor, what was expected and what was found; nothing is copied then.
    """
    missing, unknown = sorted(own.keys() - found.keys()), sorted(found.keys() - own.keys())
    if missing or unknown:
        fault = f"lacks {key}/{missing[0]}" if missing else f"has {key}/{unknown[0]} besides"
        raise CheckpointError(f"{path}: not {what} of {len(own)} tensors: it {fault}")
    for name, tensor in own.items():
        if tensor.shape != found[name].shape:
            raise CheckpointError(f"{path}: {key}/{name} is {tuple(found[name].shape)}, expected {tuple(tensor.shape)}")
        if not bool(torch.isfinite(found[name]).all()):
            raise CheckpointError(f"{path}: {key}/{name} holds numbers that are not finite")
    with torch.no_grad():
        for name, tensor in own.items():
            tensor.copy_(found[name])
