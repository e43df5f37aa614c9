"""Tensors in safetensors files with a JSON description, and checkpoints of others; no pickle is executed."""

import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch.nn.modules.module import register_module_parameter_registration_hook

from motionkit.core.errors import DamagedFileError, MotionkitError, UsageError
from motionkit.core.files import whole_file
from motionkit.training.run import check_recorded

DESCRIPTION = "description"
HINT = "train the stage again with --overwrite, or restore the file from a copy"

# Limit of a network's size relative to its file: parameters may be replaced during construction, and missing tensors
# should be reported by name.
LARGER = 4


class CheckpointError(MotionkitError):
    """A checkpoint that is missing or belongs to another model."""


def save_tensors(path: Path, tensors: Mapping[str, torch.Tensor], description: Mapping[str, Any]) -> None:
    """Write tensors and a JSON description into one file, as `whole_file` does.

    The description is in the safetensors header, so that tensors and their meaning cannot diverge.
    """
    # Clones, since safetensors refuses tensors that share memory.
    own = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    text = json.dumps(dict(description), allow_nan=False)
    with whole_file(path) as temporary:
        try:
            save_file(own, temporary, metadata={DESCRIPTION: text})
        except SafetensorError as error:
            raise OSError(f"{path} cannot be written ({error})") from None


def load_tensors(path: Path, hint: str = HINT) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read a file of `save_tensors`: tensors on the CPU, and the description.

    Raises `CheckpointError` for a missing file, and `DamagedFileError`, with `hint`, for one that is not whole, or not
    what its folder's record of sha256 says.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such checkpoint")
    check_recorded(path, hint)
    try:
        with safe_open(path, framework="pt") as opened:
            description = json.loads((opened.metadata() or {}).get(DESCRIPTION, "{}"))
            if not isinstance(description, dict):
                raise ValueError("the description in its header is no JSON object")
            return {name: opened.get_tensor(name) for name in opened.keys()}, description  # noqa: SIM118
    except (SafetensorError, ValueError, RecursionError) as error:
        raise DamagedFileError(path, one_line(error), hint) from None


def one_line(error: Exception) -> str:
    """An error's message, shortened to one line."""
    said = " ".join(str(error).split()) or type(error).__name__
    return said if len(said) <= 200 else f"{said[:200]} …"


@contextmanager
def rebuilding(path: Path, stage: str, tensors: Mapping[str, torch.Tensor]) -> Iterator[None]:
    """Context for building a stage's network from the result of `load_tensors` on `path`.

    Raises `CheckpointError` for settings whose network is far larger than the tensors, before memory is allocated, and
    for missing tensors or other types.
    """
    thread, left = threading.get_ident(), LARGER * len(tensors)
    numbers_left = LARGER * sum(tensor.numel() for tensor in tensors.values())

    def check(module: torch.nn.Module, name: str, parameter: torch.nn.Parameter) -> None:
        nonlocal left, numbers_left
        if threading.get_ident() != thread:
            return
        left, numbers_left = left - 1, numbers_left - parameter.numel()
        if left < 0 or numbers_left < 0:
            place, shape = f"{type(module).__name__}.{name}", tuple(parameter.shape)
            raise ValueError(f"its tensors are too few or too small for {place} of shape {shape}")

    hook = register_module_parameter_registration_hook(check)
    try:
        yield
    except (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError, UsageError) as error:
        raise CheckpointError(
            f"{path}: not a {stage} of this version of motionkit ({one_line(error)}); train it again "
            f"(motionkit train --stage {stage} --overwrite)"
        ) from None
    finally:
        hook.remove()


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
    """Restore the state of `optimizer_tensors`; the optimiser's parameter groups are unchanged."""
    state: dict[int, dict[str, torch.Tensor]] = {}
    for name, tensor in tensors.items():
        index, _, key = name.partition(".")
        state.setdefault(int(index), {})[key] = tensor
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def training_tensors(network: torch.nn.Module, optimizer: torch.optim.Optimizer) -> dict[str, torch.Tensor]:
    """A network's weights, and its optimiser's moments."""
    return prefixed("network", network.state_dict()) | prefixed("optimizer", optimizer_tensors(optimizer))


def load_training_tensors(
    network: torch.nn.Module, optimizer: torch.optim.Optimizer, tensors: Mapping[str, torch.Tensor]
) -> None:
    """Restore what `training_tensors` returned."""
    network.load_state_dict(unprefixed("network", tensors))
    load_optimizer_tensors(optimizer, unprefixed("optimizer", tensors))


def read_foreign(path: Path) -> dict[str, Any]:
    """The content of a PyTorch checkpoint by name, tensors on the CPU.

    Raises `CheckpointError` for a file that is missing, damaged, or would execute code (`weights_only=True` refuses).
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such file")
    try:
        loaded: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        # torch raises half a dozen classes for damaged, foreign and forbidden content.
        fault = f"not a checkpoint that can be read without running its pickle ({one_line(error)})"
        raise CheckpointError(f"{path}: {fault}") from None
    return {str(name): value for name, value in loaded.items()} if isinstance(loaded, dict) else {}


def foreign_tensors(loaded: Mapping[str, Any], key: str, path: Path, what: str) -> dict[str, torch.Tensor]:
    """The named tensors under one key of a checkpoint; raises `CheckpointError` if there are none."""
    tensors = loaded.get(key)
    if not isinstance(tensors, dict) or not all(isinstance(tensor, torch.Tensor) for tensor in tensors.values()):
        raise CheckpointError(f"{path}: not {what}, whose checkpoint has its tensors under the key {key!r}")
    return {str(name): tensor for name, tensor in tensors.items()}


def fill_checked(
    own: Mapping[str, torch.Tensor], published: Mapping[str, torch.Tensor], key: str, path: Path, what: str
) -> None:
    """Copy `published` into `own`, in place, after checking names, shapes and finiteness.

    Raises `CheckpointError` that names the tensor, and what was expected; nothing is copied then.
    """
    missing, unknown = sorted(own.keys() - published.keys()), sorted(published.keys() - own.keys())
    if missing or unknown:
        fault = f"lacks {key}/{missing[0]}" if missing else f"has {key}/{unknown[0]} besides"
        raise CheckpointError(f"{path}: not {what} of {len(own)} tensors: it {fault}")
    for name, tensor in own.items():
        if tensor.shape != published[name].shape:
            raise CheckpointError(
                f"{path}: {key}/{name} is {tuple(published[name].shape)}, expected {tuple(tensor.shape)}"
            )
        if not bool(torch.isfinite(published[name]).all()):
            raise CheckpointError(f"{path}: {key}/{name} holds numbers that are not finite")
    with torch.no_grad():
        for name, tensor in own.items():
            tensor.copy_(published[name])
