"""Two real processes train together, by Gloo on this machine; their losses are those of one."""

import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from motionkit.training.loop import load_tensors
from motionkit.training.run import RunFolder
from tests.helpers.repository import REPOSITORY
from tests.helpers.tiny import train_stage, write_store

STAGES = ("codebook", "field", "denoiser")
RANK = """
import os, signal, sys
from motionkit.training.config import apply_overrides
from pathlib import Path
import torch
from motionkit.training import loop
from motionkit.training.loop import step_generator
from motionkit.training.networks import joined_ranks
from tests.helpers.tiny import STAGES, train_stage

def interrupting(seed, purpose, step):
    if step == 3 and os.environ["RANK"] == "1":
        os.kill(os.getpid(), signal.SIGINT)
    return step_generator(seed, purpose, step)

torch.set_num_threads(1)
store, whole, interrupted, lonely = map(Path, sys.argv[1:])
with joined_ranks() as ranks:
    for name in ("codebook", "field", "denoiser"):
        train_stage(name, store, whole, shared=True)
        ranks.wait()  # as the command does: the next stage reads what the first rank saves at last
    # One clip a batch: at every step one of the ranks has nothing to do.
    stage, config = STAGES["field"]
    STAGES["field"] = (stage, apply_overrides(config, ["field.schedule.batch_size=1", "field.schedule.steps=6"]))
    train_stage("field", store, lonely, shared=True)
    STAGES["field"] = (stage, config)
    loop.step_generator = interrupting
    train_stage("field", store, interrupted, shared=True)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of one process (`one`), of two (`two`), and of two whose second rank was interrupted (`interrupted`)."""
    path = tmp_path_factory.mktemp("ranks")
    store = write_store(path / "store")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    for name in STAGES:
        train_stage(name, store, path / "one")
    torch.set_num_threads(threads)
    for run in ("interrupted", "lonely"):
        shutil.copytree(path / "one" / "codebook", path / run / "codebook")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = os.environ | {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
    command = [sys.executable, "-c", RANK, *(str(path / name) for name in ("store", "two", "interrupted", "lonely"))]
    ranks = [
        subprocess.Popen(command, cwd=REPOSITORY, env=environment | {"RANK": str(rank)}, stderr=subprocess.PIPE)
        for rank in range(2)
    ]
    told = [rank.communicate(timeout=300)[1].decode() for rank in ranks]
    assert all("KeyboardInterrupt" in each for each in told), told
    assert [rank.returncode for rank in ranks] == [-signal.SIGINT] * 2
    return path


def losses(run: Path, name: str) -> list[dict[str, float]]:
    lines = RunFolder(run).stage(name).read_metrics()
    return [{figure: value for figure, value in line.items() if figure != "seconds"} for line in lines]


@pytest.mark.parametrize("name", STAGES)
def test_two_ranks_learn_what_one_does(folder: Path, name: str) -> None:
    one, two = losses(folder / "one", name), losses(folder / "two", name)
    assert len(one) == len(two) == 1
    for expected, found in zip(one, two, strict=True):
        assert found == pytest.approx(expected, rel=1e-3, abs=1e-9)


def test_a_rank_without_a_window_in_the_batch_takes_part_all_the_same(folder: Path) -> None:
    (line,) = losses(folder / "lonely", "field")
    assert line["step"] == 6
    assert 0 < line["loss"] < 1


def test_the_latents_of_both_ranks_are_in_the_model(folder: Path) -> None:
    (one, _), (two, _) = (load_tensors(RunFolder(folder / run).stage("field").model_path) for run in ("one", "two"))
    assert one.keys() == two.keys()
    for name, expected in one.items():
        assert two[name].shape == expected.shape
        torch.testing.assert_close(two[name], expected, rtol=0.05, atol=0.02, msg=name)


def test_what_two_ranks_began_one_finishes(folder: Path) -> None:
    stage = RunFolder(folder / "interrupted").stage("field")
    assert load_tensors(stage.checkpoint_path)[1]["step"] == 4
    assert not stage.is_complete
    train_stage("field", folder / "store", folder / "interrupted", resume=True)
    (expected,), (before, after) = losses(folder / "one", "field"), losses(folder / "interrupted", "field")
    share = before["step"] / after["step"]
    found = {name: share * before[name] + (1 - share) * after[name] for name in expected} | {"step": after["step"]}
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-9)
