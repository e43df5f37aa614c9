import json
import threading
from pathlib import Path

import pytest
import torch
from safetensors.torch import save

from motionkit.core.errors import DamagedFileError
from motionkit.training.sealed_tensors import write_sealed_tensors
from motionkit.training.tensors import CheckpointError, load_tensors, rebuilding

TENSORS = {"weight": torch.zeros(3, 2), "bias": torch.zeros(3)}
PATH = Path("run/field/model.safetensors")


@pytest.mark.parametrize("description", ["{" * 50, "[" * 100_000, "7", "[1]", "null", "9" * 5000])
def test_a_description_that_is_no_object_is_damage(description: str, tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    write_sealed_tensors(path, TENSORS, {"description": description}, save)
    with pytest.raises(DamagedFileError, match=r"model\.safetensors is damaged .*--overwrite"):
        load_tensors(path)
    write_sealed_tensors(path, TENSORS, {"description": json.dumps({"step": 1})}, save)
    assert load_tensors(path)[1] == {"step": 1}


def test_a_network_is_built_from_the_tensors_that_fill_it() -> None:
    with rebuilding(PATH, "field", TENSORS):
        network = torch.nn.Linear(2, 3)
        network.load_state_dict(TENSORS)
    assert not network.weight.any()
    torch.nn.Linear(7, 7)  # once it is built, others may be of any shape


def test_a_network_of_another_size_uses_no_memory() -> None:
    told = r"too small for Linear.weight of shape \(100000000, 2\).*--stage field --overwrite"
    with pytest.raises(CheckpointError, match=told), rebuilding(PATH, "field", TENSORS):
        torch.nn.Linear(2, 100_000_000)


def test_a_network_of_more_layers_comes_to_an_end() -> None:
    with pytest.raises(CheckpointError, match="too few or too small"), rebuilding(PATH, "field", TENSORS):
        while True:
            torch.nn.Linear(2, 3)


@pytest.mark.parametrize("error", [AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError])
def test_whatever_is_missing_is_explained(error: type[Exception]) -> None:
    told = "not a field of this version of motionkit"
    with pytest.raises(CheckpointError, match=told), rebuilding(PATH, "field", TENSORS):
        raise error("width")


def test_networks_of_other_threads_are_not_looked_at() -> None:
    made: list[torch.nn.Module] = []
    with rebuilding(PATH, "field", TENSORS):
        other = threading.Thread(target=lambda: made.append(torch.nn.Linear(5, 5)))
        other.start()
        other.join()
    assert made
