from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.kinematics import forward_kinematics
from motionkit.features import humanml3d, native
from motionkit.features.layout import LAYOUTS, SMPL22_LAYOUT

SECONDS = 5
PART = SMPL22_LAYOUT.vector


def analytic_motion(fps: Fraction, name: str = "smpl22", scale: float = 1.0, walk: float = 1.0) -> np.ndarray:
    """A smooth motion as a formula of time, up to 1.5 Hz: joints sway, the body turns by more than π and walks."""
    body = LAYOUTS[name]
    rng = np.random.default_rng(0)
    t = (np.arange(int(SECONDS * fps) + 1) / float(fps))[:, None, None]
    identity = np.tile(np.array([1.0, 0, 0, 0]), (1, body.num_joints, 1))
    rest = forward_kinematics(identity, np.array([[0, 0.9, 0]]), body.skeleton)
    hertz, phase = rng.uniform(0.2, 1.5, (body.num_joints, 3)), rng.uniform(0, 6, (body.num_joints, 3))
    joints = rest + 0.03 * np.sin(2 * np.pi * hertz * t + phase)
    yaw = 1.2 * t[..., 0] + 0.4 * np.sin(2 * t[..., 0])
    x, z = joints[..., 0].copy(), joints[..., 2].copy()
    joints[..., 0] = np.cos(yaw) * x + np.sin(yaw) * z + 0.8 * walk * t[..., 0]
    joints[..., 2] = np.cos(yaw) * z - np.sin(yaw) * x + walk * np.sin(1.3 * t[..., 0])
    return (scale * joints).astype(np.float32)


@pytest.mark.parametrize("fps", [20, 60, 120])
def test_vectors_mean_the_same_at_every_framerate(fps: int) -> None:
    stride, fine_stride = fps // 10, 25
    found = native.vectors(analytic_motion(Fraction(fps)), "smpl22", Fraction(fps))[::stride]
    fine = native.vectors(analytic_motion(Fraction(250)), "smpl22", Fraction(250))[::fine_stride]
    assert found.shape == fine.shape == (10 * SECONDS + 1, 263)
    difference = np.abs(found - fine)
    inside = slice(2, -2)  # instants next to the ends have a one-sided derivative
    for block, tolerance in zip(PART.blocks, (2e-4, 5e-4, 1e-6, 1e-4, 2e-4, 5e-4), strict=False):
        assert difference[inside, block].max() < tolerance
    assert np.mean(found[:, PART.contacts] != fine[:, PART.contacts]) < 0.02


def test_velocities_are_the_formula_s_derivative() -> None:
    fps = Fraction(60)
    found = native.vectors(analytic_motion(fps), "smpl22", fps)
    fine = analytic_motion(Fraction(6000)).astype(np.float64)
    middle = np.arange(100, SECONDS * 6000, 100)
    speed = np.linalg.norm(fine[middle + 10] - fine[middle - 10], axis=-1) * 300
    velocities = found[1:-1, PART.joint_velocities].reshape(-1, 22, 3)
    assert np.allclose(np.linalg.norm(velocities, axis=-1), speed, atol=2e-3)
    contacts = found[1:-1, PART.contacts].astype(bool)
    feet = speed[:, list(SMPL22_LAYOUT.contact_joints)]
    assert np.all(contacts[np.abs(feet - 0.894) > 0.01] == (feet < 0.894)[np.abs(feet - 0.894) > 0.01])


@pytest.mark.parametrize("name", list(LAYOUTS))
@pytest.mark.parametrize("fps", [20, 120])
def test_positions_come_back_up_to_place_and_facing(name: str, fps: int) -> None:
    joints = analytic_motion(Fraction(fps), name)
    found = native.positions(native.vectors(joints, name, Fraction(fps)), name, Fraction(fps))
    assert np.allclose(found[0, 0, [0, 2]], 0)
    # A rigid motion of the horizontal plane between the two, found from the first pose.
    flat, target = (p[..., 0] + 1j * p[..., 2] for p in (found, joints))
    turn = np.vdot(flat[0] - flat[0, 0], target[0] - target[0, 0])
    placed = (flat - flat[0, 0]) * turn / abs(turn) + target[0, 0]
    assert np.abs(placed - target).max() < (0.02 if fps == 20 else 1e-3)
    assert np.allclose(found[..., 1], joints[..., 1], atol=1e-6)


def test_a_steady_turn_has_its_rate_which_is_that_of_the_turn_to_z() -> None:
    rest = analytic_motion(Fraction(1))[0]
    yaw = 1.2 * np.arange(241)[:, None] / 20
    joints = np.stack(
        (
            np.cos(yaw) * rest[:, 0] + np.sin(yaw) * rest[:, 2],
            np.broadcast_to(rest[:, 1], (241, 22)),
            np.cos(yaw) * rest[:, 2] - np.sin(yaw) * rest[:, 0],
        ),
        axis=-1,
    ).astype(np.float32)
    found = native.vectors(joints, "smpl22", Fraction(20))
    assert found[120, 0] == pytest.approx(-1.2, abs=1e-3)
    # The published number is half the angle per frame.
    assert 2 * 20 * humanml3d.vectors(joints, "smpl22")[120, 0] == pytest.approx(-1.2, abs=1e-2)
    # A body that turns as one keeps its pose, so every row is the same but for contacts at the threshold.
    assert np.allclose(found[110:130, PART.joint_rotations], found[120, PART.joint_rotations], atol=1e-3)


def test_contacts_do_not_depend_on_the_unit() -> None:
    fps = Fraction(25, 2)
    pair = [native.vectors(analytic_motion(fps, "kit21", unit, 0.3), "kit21", fps)[:, 247:] for unit in (1.0, 1000.0)]
    assert np.array_equal(*pair) and 0.05 < pair[0].mean() < 0.95
