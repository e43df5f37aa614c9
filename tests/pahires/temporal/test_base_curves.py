"""Interpolation in torch against the reference in numpy, and the forms of a network's answer."""

import numpy as np
import pytest
import torch

from motionkit.core.skeleton import SMPL22
from motionkit.features.rotations import poses_of, rows_of_poses
from motionkit.fields.interpolation import curve, rotation_curve
from motionkit.fields.motion_field import Poses
from motionkit.training.networks import VectorScaling
from pahires.temporal.base_curves import interpolated, located, seconds_beyond
from pahires.temporal.network import ObservedWindow
from pahires.temporal.prediction import Predictor, gate, num_answers, size
from pahires.temporal.settings import AnswerSettings, Base, Form
from tests.helpers.nerm_corpus import analytic_positions

TIMES = np.array([0.0, 0.1, 0.15, 0.4, 0.45, 0.7])
QUERIES = np.linspace(0.0, 0.7, 29)


def rows_at(times: np.ndarray) -> np.ndarray:
    return rows_of_poses(Poses(analytic_positions(times, 1)), SMPL22).vectors


def asked(times: np.ndarray, queries: np.ndarray, scaling: VectorScaling) -> ObservedWindow:
    return ObservedWindow(
        scaling.apply(torch.from_numpy(rows_at(times)[None])),
        torch.from_numpy(times[None].astype(np.float32)),
        torch.from_numpy(queries[None].astype(np.float32)),
        torch.full((1,), 1 / 30),
    )


@pytest.fixture
def scaling() -> VectorScaling:
    rng = np.random.default_rng(0)
    mean, scale = rng.normal(size=135), rng.uniform(0.1, 2.0, 135)
    return VectorScaling(torch.from_numpy(mean.astype(np.float32)), torch.from_numpy(scale.astype(np.float32)))


@pytest.mark.parametrize("base", ["linear", "catmull-rom"])
def test_curves_are_those_of_the_reference(base: Base, scaling: VectorScaling) -> None:
    found = scaling.invert(interpolated(asked(TIMES, QUERIES, scaling), base, scaling))[0].numpy()
    np.testing.assert_allclose(found, curve(base, TIMES, rows_at(TIMES))(QUERIES), atol=2e-5)  # type: ignore[arg-type]


def test_slerp_turns_every_joint_on_its_great_arc(scaling: VectorScaling) -> None:
    found = scaling.invert(interpolated(asked(TIMES, QUERIES, scaling), "slerp", scaling))[0].numpy()
    given = rows_of_poses(Poses(analytic_positions(TIMES, 1)), SMPL22)
    rotations = given.poses().local_rotations
    assert rotations is not None
    expected = rotation_curve("slerp", TIMES, rotations.astype(np.float64))(QUERIES)
    made = poses_of(found, given.bones[:1], SMPL22).local_rotations
    assert made is not None
    np.testing.assert_allclose(np.abs(np.sum(made * expected, axis=-1)), 1.0, atol=1e-5)


def test_queries_find_their_segment_and_what_lies_beyond(scaling: VectorScaling) -> None:
    window = asked(TIMES, np.array([-0.2, 0.0, 0.05, 0.15, 0.7, 0.8]), scaling)
    segment, fraction = located(window)
    assert segment[0].tolist() == [0, 0, 0, 2, 4, 4]
    assert fraction[0].tolist() == pytest.approx([0, 0, 0.5, 0, 1, 1], abs=1e-6)
    assert seconds_beyond(window)[0].tolist() == pytest.approx([-0.2, 0, 0, 0, 0, 0.1], abs=1e-6)
    assert gate(window)[0, [1, 3, 4], 0].abs().max() < 1e-5 and gate(window)[0, 2, 0] == pytest.approx(1.0)
    # How much an interpolation may miss grows with the square of the gap, and beyond the ends from nothing.
    expected = [h**2 / (h**2 + 0.35**2) for h in (0.4, 0.1, 0.1, 0.25, 0.25, 0.2)]
    assert size(window, "gap")[0, :, 0].tolist() == pytest.approx(expected, rel=1e-4)


def test_forms_add_what_the_network_says(scaling: VectorScaling) -> None:
    window = asked(TIMES, QUERIES, scaling)
    answer = torch.ones(1, len(QUERIES), 135)

    def made(form: Form) -> torch.Tensor:
        return Predictor(lambda _: answer, scaling, AnswerSettings(form, "slerp", scale=0.5))(window)

    curve_alone = interpolated(window, "slerp", scaling)
    torch.testing.assert_close(made("plain"), answer)
    torch.testing.assert_close(made("residual"), curve_alone + 0.5 * size(window, "gap"))
    torch.testing.assert_close(made("exact"), curve_alone + 0.5 * size(window, "gap") * gate(window))


def test_blended_curves_are_what_the_weights_say(scaling: VectorScaling) -> None:
    window = asked(TIMES, QUERIES, scaling)
    blended: tuple[Base, ...] = ("catmull-rom", "linear")

    def made(weights: tuple[float, float]) -> torch.Tensor:
        rows = torch.tensor([0.0, *weights]).repeat_interleave(135)
        answer = rows.expand(1, len(QUERIES), -1)
        return Predictor(lambda _: answer, scaling, AnswerSettings("exact", "cubic", blended))(window)

    for weights, name in (((0.0, 0.0), "cubic"), ((1.0, 0.0), "catmull-rom"), ((0.0, 1.0), "linear")):
        wanted = interpolated(window, name, scaling)  # type: ignore[arg-type]
        torch.testing.assert_close(made(weights), wanted, atol=1e-5, rtol=1e-5)
    assert num_answers(AnswerSettings("exact", blended=blended), 135) == 405
    assert num_answers(AnswerSettings("plain", blended=blended), 135) == 135


def test_smooth_corrections_have_half_the_kink_and_leave_frames_alone(scaling: VectorScaling) -> None:
    times = np.arange(9) * 0.1
    ones = Predictor(
        lambda asked: torch.ones(*asked.queries_seconds.shape, 135), scaling, AnswerSettings("exact", "eased")
    )
    queries = np.linspace(0.0, 0.8, 321)
    window = asked(times, queries, scaling)
    curve = interpolated(window, "eased", scaling)
    made = {"kinked": ones(window) - curve, "smooth": ones.smooth(window) - curve}
    torch.testing.assert_close(made["smooth"][0, ::40], torch.zeros(9, 135), atol=1e-5, rtol=0.0)
    bends = {name: float(each[0, 20:-20].diff(n=2, dim=0).abs().max()) for name, each in made.items()}
    assert bends["smooth"] < 0.55 * bends["kinked"]
    # Half-way the three are 1, ¾ and ¾ of it, less the ⅜ that are left at frames.
    assert float(made["smooth"][0, 180, 0]) > 0.45 * float(made["kinked"][0, 180, 0])
