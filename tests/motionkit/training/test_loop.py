"""The training loop and its files: resumed bit by bit; what is damaged or does not fit is refused."""

import os
import signal
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
import torch
from safetensors.torch import save

from motionkit.core.errors import DamagedFileError
from motionkit.training.config import Schedule
from motionkit.training.loop import (
    CheckpointError,
    Learner,
    load_tensors,
    save_tensors,
    seeded_initialisation,
    train_loop,
)
from motionkit.training.run import RunError, StageFolder

SCHEDULE = Schedule(20, kind="cosine", warmup_fraction=0.2)


class Regression:
    """A linear map learnt from random batches: the smallest thing with weights, moments and an average."""

    def __init__(self, before_step: Callable[[int], None] = lambda step: None, steps: int = 20) -> None:
        self.steps = steps
        with seeded_initialisation(3, "model"):
            self.model = torch.nn.Linear(4, 2)
        optimizer = torch.optim.AdamW(self.model.parameters(), lr=1e-2)
        self.learner = Learner(self.model, optimizer, ema_decay=0.9)
        self.state_tensors, self.load_state_tensors = self.learner.state_tensors, self.learner.load_state_tensors
        self.before_step = before_step

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        self.before_step(step)
        inputs = torch.randn(8, 4, generator=generator)
        loss = (self.model(inputs) - inputs[:, :2]).square().mean()
        self.learner.descend(loss, step, 1e-2 * SCHEDULE.factor(step, 20))
        return {"loss": loss}


def _folder(path: Path) -> StageFolder:
    path.mkdir(parents=True, exist_ok=True)
    return StageFolder(path)


def _interrupt_at(step: int, number: int = signal.SIGINT) -> Callable[[int], None]:
    return lambda now: os.kill(os.getpid(), number) if now == step else None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_and_resumed_training_equals_an_uninterrupted_one_bit_by_bit(number, tmp_path):
    whole, parts = _folder(tmp_path / "a" / "stage"), _folder(tmp_path / "b" / "stage")
    reference = Regression()
    train_loop(reference, whole, seed=1, log_every=4)

    with pytest.raises(KeyboardInterrupt):
        train_loop(Regression(_interrupt_at(5, number)), parts, seed=1, log_every=4)
    assert load_tensors(parts.checkpoint_path)[1]["step"] == 6
    resumed = Regression()
    train_loop(resumed, parts, seed=1, log_every=4)

    expected = reference.state_tensors()
    for name, tensor in resumed.state_tensors().items():
        assert torch.equal(tensor, expected[name]), name
    losses = [{line["step"]: line["loss"] for line in folder.read_metrics()} for folder in (whole, parts)]
    assert list(losses[1]) == [4, 6, 8, 12, 16, 20]
    assert all(losses[1][step] == losses[0][step] for step in (4, 12, 16, 20))
    seconds = [line["seconds"] for line in parts.read_metrics()]
    assert seconds == sorted(seconds)


def test_metrics_ahead_of_the_checkpoint_are_forgotten(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "stage")
    with pytest.raises(KeyboardInterrupt):
        train_loop(Regression(_interrupt_at(5), 8), folder, seed=1, log_every=2)
    folder.append_metrics({"step": 7.0, "loss": 99.0})
    train_loop(Regression(steps=8), folder, seed=1, log_every=2)
    assert [line["step"] for line in folder.read_metrics()] == [2, 4, 6, 8]


def test_a_loss_that_is_not_finite_stops_the_training(tmp_path: Path) -> None:
    class Diverging(Regression):
        def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
            return {"loss": torch.tensor(float("nan") if step == 2 else 1.0)}

    folder = _folder(tmp_path / "stage")
    with pytest.raises(RunError, match="loss is not finite"):
        train_loop(Diverging(steps=5), folder, seed=0, log_every=2, checkpoint_seconds=0.0)
    assert load_tensors(folder.checkpoint_path)[1]["step"] == 2


def test_a_checkpoint_of_another_version_or_training_says_what_to_do(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "stage")
    with pytest.raises(KeyboardInterrupt):
        train_loop(Regression(_interrupt_at(5)), folder, seed=1)
    tensors, description = load_tensors(folder.checkpoint_path)
    renamed = {f"new/{name}": tensor for name, tensor in tensors.items()}
    for content in ((renamed, description), *((tensors, description | {name: 99}) for name in ("stage", "step"))):
        save_tensors(folder.checkpoint_path, *content)
        with pytest.raises(CheckpointError, match="train the stage again with --overwrite"):
            train_loop(Regression(), folder, seed=1)


def test_a_weight_average_of_constant_weights_is_those_weights() -> None:
    module = torch.nn.Linear(2, 2)
    learner = Learner(module, torch.optim.SGD(module.parameters(), lr=1.0), ema_decay=0.99)
    for step in range(5):
        learner.descend(module(torch.ones(2)).sum(), step, rate=0.0)
    assert torch.allclose(learner.trained_tensors()["weight"], module.weight)
    learner.descend(module(torch.ones(2)).sum(), 0, rate=1.0)  # The gradient of each weight is 1.
    assert torch.allclose(learner.trained_tensors()["weight"], module.weight + 0.1)


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
