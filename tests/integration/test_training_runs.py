"""Whole trainings: an interrupted or killed one is resumed exactly; what a crash leaves; what is reported."""

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch

from motionkit.training import loop, networks
from motionkit.training.loop import step_generator
from motionkit.training.run import RunError, RunFolder, StageFolder
from tests.helpers.tiny import NERM, STAGES, train_stage, write_store


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Sums of several threads come in another order on another machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module", autouse=True)
def two_lines() -> Iterator[None]:
    """The field logs its fifth step too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "train_loop", partial(loop.train_loop, log_every=5))
        yield


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_store(tmp_path_factory.mktemp("training") / "store")


@pytest.fixture(scope="module")
def run(store: Path) -> Path:
    """All stages, trained without interruption."""
    path = store.parent / "whole"
    for name in STAGES:
        train_stage(name, store, path)
    return path


@pytest.fixture
def other_run(run: Path, tmp_path: Path) -> Callable[[str], StageFolder]:
    """A run that lacks one stage, and has the others from the whole one."""

    def without(name: str) -> StageFolder:
        shutil.copytree(run, tmp_path / "run", ignore=lambda folder, names: [name] if Path(folder) == run else [])
        return StageFolder(tmp_path / "run" / name)

    return without


def figures(folder: StageFolder) -> list[dict[str, float]]:
    """What was logged, without the clock."""
    return [{name: value for name, value in line.items() if name != "seconds"} for line in folder.read_metrics()]


@pytest.mark.parametrize("name", STAGES)
def test_an_interrupted_run_equals_an_uninterrupted_one_bit_by_bit(name, store, run, other_run, monkeypatch):
    def interrupting(seed: int, purpose: str, step: int) -> torch.Generator:
        if step == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return step_generator(seed, purpose, step)

    folder = other_run(name)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(loop, "step_generator", interrupting)
        train_stage(name, store, folder.path.parent)
    assert not folder.is_complete
    torch.rand(3)  # the global generator plays no part
    train_stage(name, store, folder.path.parent, resume=True)
    assert folder.model_path.read_bytes() == RunFolder(run).stage(name).model_path.read_bytes()


def test_the_chosen_precision_is_written_down_and_hardly_changes_what_is_learnt(store, run, other_run, monkeypatch):
    folder = other_run("field")
    monkeypatch.setattr(networks, "has_bfloat16", lambda device: True)
    asked = replace(NERM, field=replace(NERM.field, precision="auto"))
    monkeypatch.setitem(STAGES, "field", (STAGES["field"][0], asked))
    train_stage("field", store, folder.path.parent)
    assert folder.read_config()["config"]["field"]["precision"] == "bfloat16"
    (_, found), (_, expected) = figures(folder), figures(RunFolder(run).stage("field"))
    assert found != expected
    assert found["reconstruction"] == pytest.approx(expected["reconstruction"], rel=0.2)
    monkeypatch.setattr(networks, "has_bfloat16", lambda device: False)
    with pytest.raises(RunError, match=r"field.precision 'bfloat16' → 'float32'"):
        train_stage("field", store, folder.path.parent, resume=True)
