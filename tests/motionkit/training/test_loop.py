import os
import signal
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
import torch

from motionkit.training.config import Schedule
from motionkit.training.loop import (
    Learner,
    load_tensors,
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
def test_an_interrupted_and_resumed_training_equals_an_uninterrupted_one_bit_by_bit(
    number: int, tmp_path: Path
) -> None:
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
    losses = [[line["loss"] for line in folder.read_metrics()] for folder in (whole, parts)]
    assert losses[0] == losses[1]
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
        train_loop(Diverging(steps=5), folder, seed=0, checkpoint_seconds=0.0)
    assert load_tensors(folder.checkpoint_path)[1]["step"] == 2


def test_a_weight_average_of_constant_weights_is_those_weights() -> None:
    module = torch.nn.Linear(2, 2)
    learner = Learner(module, torch.optim.SGD(module.parameters(), lr=1.0), ema_decay=0.99)
    for step in range(5):
        learner.descend(module(torch.ones(2)).sum(), step, rate=0.0)
    assert torch.allclose(learner.trained_tensors()["weight"], module.weight)
    learner.descend(module(torch.ones(2)).sum(), 0, rate=1.0)  # The gradient of each weight is 1.
    assert torch.allclose(learner.trained_tensors()["weight"], module.weight + 0.1)
