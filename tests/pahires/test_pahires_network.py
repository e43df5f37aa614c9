"""PA-HiRes's network: what it depends on, what a query costs, that it learns."""

from pathlib import Path

import numpy as np
import pytest
import torch

from motionkit.edit.encoders import encoder_loader
from motionkit.fields.motion_field import MotionEncoder
from motionkit.training.config import apply_overrides
from motionkit.training.loop import seeded_initialisation
from motionkit.training.pose_vectors import VectorScaling
from motionkit.training.run import RunFolder, StageContext
from pahires.model import SYSTEM, PaHiRes
from pahires.recipes import NetworkSettings
from pahires.temporal.encoder import NetworkEncoder
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import AnswerSettings
from tests.helpers.tiny import write_store
from tests.helpers.tiny_temporal import PAHIRES, PAHIRES_NETWORK


def network(settings: NetworkSettings = PAHIRES_NETWORK) -> PaHiRes:
    with seeded_initialisation(0, "network"):
        made = PaHiRes(settings, 135)
        torch.nn.init.normal_(made.answer.weight, std=0.1)
    return made.eval()


def window(times: torch.Tensor, queries: torch.Tensor, batch: int = 3) -> ObservedWindow:
    frames = torch.randn(batch, len(times), 135, generator=torch.Generator().manual_seed(5))
    return ObservedWindow(
        frames, times.expand(batch, -1).clone(), queries.expand(batch, -1).clone(), torch.full((batch,), 1 / 30)
    )


UNEVEN = torch.tensor([0.0, 0.03, 0.1, 0.13, 0.5, 0.9, 0.95, 1.0])
QUERIES = torch.linspace(-0.2, 1.3, 40)


def test_an_answer_does_not_depend_on_what_else_is_asked() -> None:
    made, asked = network(), window(UNEVEN, QUERIES)
    whole = made(asked)
    order = torch.randperm(40, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(
        made(asked.asked(asked.queries_seconds[:, order])), whole[:, order], atol=2e-5, rtol=1e-4
    )
    torch.testing.assert_close(
        made(asked.asked(asked.queries_seconds[:, 17:19])), whole[:, 17:19], atol=2e-5, rtol=1e-4
    )


def test_a_trained_network_is_an_encoder(tmp_path: Path) -> None:
    run, config = RunFolder(tmp_path / "run"), apply_overrides(PAHIRES, ["training.schedule.steps=2"])
    SYSTEM.stage.train(StageContext(write_store(tmp_path / "store"), run, "tiny", device="cpu"), config)
    encoder = encoder_loader("pahires").load(run.path)
    assert isinstance(encoder, NetworkEncoder) and isinstance(encoder, MotionEncoder) and encoder.name == "PA-HiRes"
    assert encoder.reach_seconds == pytest.approx(8 / 30) and encoder.longest_gap_seconds == pytest.approx(10 / 30)


def test_one_motion_is_learnt_better_than_any_interpolation_of_it() -> None:
    """A network that can represent a motion beats the curve that its answers correct, on that motion."""
    from pahires.temporal.base_curves import interpolated
    from pahires.temporal.prediction import Predictor

    times = torch.arange(0, 65, 8) / 30
    queries = torch.arange(65) / 30

    def rows(seconds: torch.Tensor) -> torch.Tensor:
        phases = torch.linspace(0, 3, 135)
        return torch.sin(2 * np.pi * 1.4 * seconds[:, None] + phases)[None]

    asked = ObservedWindow(rows(times), times[None], queries[None], torch.full((1,), 1 / 30))
    made = network()
    predictor = Predictor(made, VectorScaling(torch.zeros(135), torch.ones(135)), AnswerSettings("exact", "eased"))
    optimizer = torch.optim.Adam(made.parameters(), lr=3e-3)
    for _ in range(120):
        optimizer.zero_grad()
        loss = (predictor(asked) - rows(queries)).square().mean()
        loss.backward()
        optimizer.step()
    curve = (interpolated(asked, "eased", predictor.scaling) - rows(queries)).square().mean()
    assert float(loss.detach()) < 0.1 * float(curve)
