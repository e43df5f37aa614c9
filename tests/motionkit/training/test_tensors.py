from pathlib import Path

import pytest
import torch
from safetensors.torch import save

from motionkit.core.errors import DamagedFileError
from motionkit.training.loop import CheckpointError, load_tensors, save_tensors
from motionkit.training.run import StageFolder

TENSORS = {"weight": torch.zeros(3, 2), "bias": torch.zeros(3)}


def test_a_flipped_byte_in_the_weights_of_a_complete_stage_is_refused(tmp_path: Path) -> None:
    folder = StageFolder(tmp_path)
    save_tensors(folder.model_path, TENSORS, {"step": 3})
    folder.finish({"loss": 0.1})
    whole = folder.model_path.read_bytes()
    assert load_tensors(folder.model_path)[1] == {"step": 3}
    for place in (9, len(whole) // 2, len(whole) - 1):
        folder.model_path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(DamagedFileError, match=r"model\.safetensors is damaged .*--overwrite"):
            load_tensors(folder.model_path)


def test_tensors_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file.safetensors"
    tensors = {"a": torch.arange(6).reshape(2, 3), "b": torch.randn(3, dtype=torch.float64)[::2]}
    save_tensors(path, tensors, {"note": "ä", "list": [1, 2]})
    loaded, description = load_tensors(path)
    assert description == {"note": "ä", "list": [1, 2]}
    assert all(torch.equal(loaded[name], tensor) for name, tensor in tensors.items())
    with pytest.raises(CheckpointError, match="there is no such checkpoint"):
        load_tensors(tmp_path / "absent.safetensors")


WHOLE = save(TENSORS)


@pytest.mark.parametrize("content", [b"", WHOLE[:40], WHOLE[:-1], WHOLE + b"0", bytes(100)], ids=len)
def test_a_file_that_is_not_whole_is_damaged(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes(content)
    with pytest.raises(DamagedFileError, match=r"checkpoint\.safetensors is damaged"):
        load_tensors(path)
