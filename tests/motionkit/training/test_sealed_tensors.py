import json
import os
import resource
import stat
from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import save as save_arrays
from safetensors.torch import save_file

from motionkit.core.checksums import require_whole_tensors
from motionkit.core.errors import DamagedFileError
from motionkit.training.sealed_tensors import checked_metadata, write_sealed_tensors
from motionkit.training.tensors import load_tensors, save_tensors

TENSORS = {"a": torch.arange(6.0).reshape(2, 3), "half": torch.ones(3, dtype=torch.bfloat16)}


@pytest.fixture
def small_disk() -> Iterator[None]:
    """Files of this process may have 4096 bytes; more fails as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_every_flipped_byte_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    # Zeros where the checksum is not, and its key where it is not one.
    save_tensors(path, TENSORS | {"sha256": torch.zeros(2)}, {"sha256": "0" * 64, "step": 3})
    whole = path.read_bytes()
    for place, flip in zip(range(len(whole)), cycle((0x01, 0x20, 0x80, 0xFF))):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :])
        with pytest.raises(DamagedFileError, match=r"model\.safetensors is damaged .*--overwrite"):
            load_tensors(path)


def no_checksum(path: Path) -> None:
    save_file(TENSORS, path, metadata={"description": json.dumps({"step": 3})})


def one_byte_more(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"0")


def zeros(path: Path) -> None:
    path.write_bytes(bytes(100))


def cut(length: int, path: Path) -> None:
    path.write_bytes(path.read_bytes()[:length])


@pytest.mark.parametrize(
    "damage", [no_checksum, one_byte_more, zeros, *(partial(cut, length) for length in (0, 2, 3, 8, 40, 100, -1))]
)
@pytest.mark.parametrize("reads", [load_tensors, partial(require_whole_tensors, hint="train it again")])
def test_a_file_that_is_not_whole_is_damaged(
    damage: Callable[[Path], None], reads: Callable[[Path], object], tmp_path: Path
) -> None:
    path = tmp_path / "model.safetensors"
    save_tensors(path, TENSORS, {})
    reads(path)
    damage(path)
    with pytest.raises(DamagedFileError, match=r"model\.safetensors is damaged"):
        reads(path)


def test_a_header_with_an_unknown_key_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "rows.safetensors"
    write_sealed_tensors(path, {"rows": np.arange(4)}, {"other": "k"}, save_arrays)
    with pytest.raises(DamagedFileError, match="unknown key 'other'"):
        checked_metadata(path, {"key"}, "delete it")


def test_other_programs_read_the_file(tmp_path: Path) -> None:
    path = tmp_path / "rows.safetensors"
    write_sealed_tensors(path, {"rows": np.arange(4)}, {"key": "k"}, save_arrays)
    assert checked_metadata(path, {"key"}, "delete it")["key"] == "k"
    with safe_open(path, framework="np") as opened:
        np.testing.assert_array_equal(opened.get_tensor("rows"), np.arange(4))


def test_the_same_tensors_are_the_same_bytes(tmp_path: Path) -> None:
    for name in "abcdefgh":
        save_tensors(tmp_path / name, TENSORS, {"step": 3})
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1


def test_tensors_that_share_memory_are_saved(tmp_path: Path) -> None:
    whole = torch.arange(6.0)
    save_tensors(tmp_path / "a", {"whole": whole, "part": whole[2:], "turned": whole.reshape(2, 3).T}, {})
    tensors, _ = load_tensors(tmp_path / "a")
    assert torch.equal(tensors["part"], whole[2:])
    assert torch.equal(tensors["turned"], whole.reshape(2, 3).T)


def test_permissions_follow_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        save_tensors(tmp_path / "model.safetensors", TENSORS, {})
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "model.safetensors").stat().st_mode) == 0o644


def test_a_full_disk_names_the_file_and_leaves_the_old_one(tmp_path: Path, small_disk: None) -> None:
    path = tmp_path / "checkpoint.safetensors"
    save_tensors(path, TENSORS, {"step": 1})
    with pytest.raises(OSError, match=r"checkpoint\.safetensors"):
        save_tensors(path, {"a": torch.zeros(4096)}, {"step": 2})
    assert load_tensors(path)[1] == {"step": 1}
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
