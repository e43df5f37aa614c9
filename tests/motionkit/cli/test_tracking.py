"""Curves as TensorBoard reads them, of a training that was resumed."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from motionkit.cli.train import tensorboard_events
from motionkit.training.run import RunFolder
from motionkit.training.stage import StageContext

accumulator = pytest.importorskip(
    "tensorboard.backend.event_processing.event_accumulator", reason="needs the extra motionkit[track]"
)


@dataclass(frozen=True)
class Settings:
    rate: float = 0.1


def test_what_is_logged_goes_to_tensorboard(tmp_path: Path) -> None:
    lines = {"first": (50, 100), "again": (75, 100)}
    for session, steps in lines.items():
        with tensorboard_events(tmp_path / "boards") as told:
            context = StageContext(tmp_path / "store", RunFolder(tmp_path / session), "nano", on_metrics=told)
            folder = context.begin("field", Settings(), store_fingerprint="")
            for step in steps:
                folder.append_metrics({"step": float(step), "loss": 1.0 / step})
    board = accumulator.EventAccumulator(str(tmp_path / "boards" / "field"))
    board.Reload()
    assert [(event.step, event.value) for event in board.Scalars("loss")] == [
        (step, pytest.approx(1.0 / step)) for step in (50, 75, 100)
    ]
