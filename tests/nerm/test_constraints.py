"""Latents that are held to constraints, where the best one is known."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import torch

from motionkit.core.skeleton import SMPL22
from motionkit.fields.motion_field import to_motion
from motionkit.generate.constraints import Constraint
from nerm.constraints import ConstraintCost, FootSliding, Search
from tests.helpers.analytic import analytic_motion

BODY = torch.from_numpy(np.random.default_rng(0).normal(size=(22, 3))).float()
HEAD = SMPL22.joint_names.index("head")


def linear(count: int, numbers: int = 6) -> tuple[torch.Tensor, object]:
    """A field whose joints are linear in the latent, and its matrix: [instants, joints, 3, numbers]."""
    matrix = torch.randn(count, 22, 3, numbers, generator=torch.Generator().manual_seed(count))
    return matrix, lambda latent: BODY + matrix @ latent


def test_the_search_finds_the_optimum_of_a_linear_field() -> None:
    """½‖(n − n₀)/σ‖² + ½‖A n + c − b‖²/τ² has its minimum where the normal equations say."""
    matrix, joints = linear(2)
    wanted = Constraint.joint("head", (0.3, 1.0, -2.0), 1.0, 1.04)
    assert len(wanted.seconds) == 2
    drawn, sigma, tau = torch.arange(6.0), 0.5, wanted.deviation
    a = matrix[:, HEAD].reshape(-1, 6).double()
    b = torch.tensor([0.3, 1.0, -2.0]).double().repeat(2) - BODY[HEAD].double().repeat(2)
    gram = torch.eye(6).double() / sigma**2 + a.T @ a / tau**2
    best = torch.linalg.solve(gram, drawn.double() / sigma**2 + a.T @ b / tau**2)
    found, place = Search(drawn, sigma, lambda numbers: numbers, ConstraintCost(joints, (wanted,))).run(60)
    torch.testing.assert_close(found.double(), best, atol=2e-3, rtol=0)
    assert place.tolist() == [0.0, 0.0, 0.0]


def test_a_path_says_where_the_motion_lies() -> None:
    """A body that walks along Z+ is turned and moved onto a path along X, at no cost but that of the corner."""
    path = Constraint.path([(5.0, 1.0), (7.0, 1.0)], [0.0, 2.0])
    ahead = torch.from_numpy(path.seconds).float()[:, None, None] * torch.tensor([0.0, 0.0, 1.0])
    held = ConstraintCost(lambda latent: BODY - BODY[:1] * torch.tensor([1.0, 0.0, 1.0]) + ahead, (path,))
    place = held.place(torch.zeros(6))
    torch.testing.assert_close(place, torch.tensor([math.pi / 2, 5.0, 1.0]), atol=1e-5, rtol=0)
    assert float(held.cost(torch.zeros(6), place)) < 1e-6
    aside = held.cost(torch.zeros(6), place + torch.tensor([0.0, 0.0, 0.06]))
    assert float(aside) == pytest.approx(len(path.seconds) * 0.5 * (0.06 / path.deviation) ** 2, rel=1e-3)


def test_a_heading_costs_what_the_chord_is_long() -> None:
    facing = BODY.clone()
    facing[[1, 16]], facing[[2, 17]] = torch.tensor([1.0, 1.0, 0.0]), torch.tensor([-1.0, 1.0, 0.0])  # left is X+
    north, east = (Constraint.path([(0, 0), (0, 0)], [0, 0.1], [turn, turn]) for turn in (0.0, math.pi / 2))
    free = tuple(replace(each, positions=np.full_like(each.positions, np.nan)) for each in (north, east))
    costs = [
        float(ConstraintCost(lambda latent: facing.expand(2, -1, -1), (each,)).cost(torch.zeros(6), torch.zeros(3)))
        for each in free
    ]
    assert costs[0] == pytest.approx(0.0, abs=1e-6)
    assert costs[1] == pytest.approx(2 * 0.5 * 2.0 * (0.3 / north.deviation) ** 2, rel=1e-4)


def test_bones_of_another_length_cost_at_poses_alone() -> None:
    wanted = (Constraint.pose(BODY.double().numpy(), 0.0), Constraint.path([(0, 0), (1, 0)], [0.0, 0.125]))
    of_pose, of_path = (
        ConstraintCost(lambda latent, n=len(each.seconds): BODY.expand(n, -1, -1), (each,)) for each in wanted
    )
    assert of_pose.bones is not None and of_path.bones is None
    for held, more in ((of_pose, 21 * 0.5 * (0.01 / 0.003) ** 2), (of_path, 0.0)):
        same, longer = (float(held.cost(torch.zeros(6), torch.zeros(3), of_pose.bones + by)) for by in (0.0, 0.01))
        assert longer - same == pytest.approx(more, rel=1e-3, abs=1e-3)


def test_feet_that_stand_cost_what_they_slide() -> None:
    performance = analytic_motion("walk", 4.0)
    walk = torch.from_numpy(to_motion(performance, Fraction(60)).joint_positions)
    drift = torch.arange(len(walk))[:, None, None] / 60 * torch.tensor([0.0, 0.0, 0.5])
    rise = drift.flip(-1).roll(1, -1)
    feet = FootSliding(lambda latent: walk + latent[0] * drift + latent[1] * rise, torch.zeros(2))
    assert 0.3 < float((feet.contact > 0.5).float().mean()) < 0.9
    base, sliding, rising = (float(feet.cost(torch.tensor(each))) for each in ([0.0, 0.0], [1.0, 0.0], [0.0, 1.0]))
    assert sliding - base > 10.0
    assert rising == pytest.approx(base, rel=1e-4)
