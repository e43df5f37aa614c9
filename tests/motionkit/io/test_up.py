"""The axis that points up: inferred from bodies that stand, walk and lie, whatever the file's axes are; or given."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core import kinematics
from motionkit.features.quality import measure
from motionkit.fields.motion_field import to_motion
from motionkit.io.amass import write_amass
from motionkit.io.smpl_body import mean_shape_skeleton
from tests.helpers.analytic import AnalyticMotion
from tests.helpers.bones import check_rotations

FPS = Fraction(30)
# The rotations about x by ±90 degrees, as quaternions: y up → z up, and its inverse.
TO_Z_UP = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])
TO_Y_UP = TO_Z_UP * [1, -1, 1, 1]
# About y.
HALF_TURN = np.array([0.0, 0.0, 1.0, 0.0])
BODY = mean_shape_skeleton()


def moved(motion: mk.Motion, step: Sequence[float]) -> mk.Motion:
    assert motion.root_translation is not None
    positions, root = (each + np.float32(step) for each in (motion.joint_positions, motion.root_translation))
    return replace(motion, joint_positions=positions, root_translation=root)


def standing(
    heading: float = 0.0, speed: float = 0.0, at: tuple[float, float] = (0.0, 0.0), arms: float = 0.2
) -> mk.Motion:
    """A body on its feet, y up, that walks at a speed in m/s or stands at a place of the floor, and swings its arms."""
    field = AnalyticMotion(3.0, BODY, heading, speed, lift=0.05 * bool(speed), arms=arms)
    return moved(to_motion(field, FPS), (at[0], 0.0, at[1]))


def lying(face: str, at: tuple[float, float] = (0.0, 0.0), arms: float = 0.4) -> mk.Motion:
    """A body on the floor with its head along +z, y up."""
    turn = TO_Z_UP if face == "down" else kinematics.quaternion_multiply(TO_Z_UP, HALF_TURN)
    motion = turned(standing(arms=arms), turn)
    assert motion.root_translation is not None
    x, _, z = motion.root_translation[0]
    return moved(motion, (at[0] - x, 0.04 - np.median(motion.joint_positions[..., 1].min(axis=1)), at[1] - z))


def turned(motion: mk.Motion, turn: np.ndarray) -> mk.Motion:
    """The same in a world with other axes; the rest pose stays."""
    assert motion.local_rotations is not None and motion.root_translation is not None
    rotations = motion.local_rotations.astype(np.float64)
    rotations[:, 0] = kinematics.quaternion_multiply(turn, rotations[:, 0])
    root = kinematics.quaternion_rotate(turn, motion.root_translation.astype(np.float64))
    rotations, root = rotations.astype(np.float32), root.astype(np.float32)
    return replace(
        motion,
        joint_positions=kinematics.forward_kinematics(rotations, root, motion.skeleton),
        local_rotations=rotations,
        root_translation=root,
    )


def bvh(motion: mk.Motion, folder: Path) -> Path:
    """A BVH file of the motion as it is: its rest pose is y up."""
    mk.write(motion, folder / "take.bvh")
    return folder / "take.bvh"


def amass(motion: mk.Motion, folder: Path) -> Path:
    """An AMASS file along the motion's own axes: its writer turns y to z."""
    write_amass(turned(motion, TO_Y_UP), folder / "take_poses.npz")
    return folder / "take_poses.npz"


def joints(motion: mk.Motion, folder: Path) -> Path:
    """An array of joint positions."""
    np.save(folder / "take.npy", motion.joint_positions)
    (folder / "motions.json").write_text('{"fps": 30}')
    return folder / "take.npy"


def npz(motion: mk.Motion, folder: Path) -> Path:
    """motionkit's own file, which is y up."""
    mk.write(motion, folder / "take.npz")
    return folder / "take.npz"


Write = Callable[[mk.Motion, Path], Path]
STANDING = {
    "walks along x": standing(np.pi / 2, 1.2),
    "walks along z": standing(0.0, 1.2, at=(3.0, -2.0)),
    "stands at the origin and faces −z": standing(np.pi),
    "stands elsewhere": standing(0.3, at=(0.4, 1.1)),
}
LYING = {
    "on its face": lying("down"),
    "on its back, elsewhere": lying("up", at=(2.0, 1.8)),
    "still": lying("up", arms=0.0),
}


def assert_joints(motion: mk.Motion, positions: np.ndarray) -> None:
    order = [motion.skeleton.index(joint) for joint in BODY.joint_names]
    np.testing.assert_allclose(motion.joint_positions[:, order], positions, atol=1e-4)


@pytest.mark.parametrize("write", [bvh, amass, joints])
@pytest.mark.parametrize("turn", [None, TO_Z_UP], ids=["y up", "z up"])
@pytest.mark.parametrize("name", STANDING)
def test_who_stands_is_read_upright_whatever_the_axes(tmp_path, name, turn, write):
    expected = STANDING[name]
    motion = mk.read(write(expected if turn is None else turned(expected, turn), tmp_path))
    assert motion.fps == FPS
    assert_joints(motion, expected.joint_positions)
    assert "lying" not in measure(motion).flags


@pytest.mark.parametrize(("write", "turn"), [(bvh, None), (joints, None), (amass, TO_Z_UP)])
@pytest.mark.parametrize("name", LYING)
def test_who_lies_on_the_floor_stays_there_and_is_flagged(tmp_path, name, turn, write):
    """With the head along the axis that points up in other files: +z of a BVH file that rests y up, +y of AMASS's."""
    expected = LYING[name] if turn is None else turned(LYING[name], HALF_TURN)
    motion = mk.read(write(expected if turn is None else turned(expected, turn), tmp_path))
    assert_joints(motion, expected.joint_positions)
    assert "lying" in measure(motion).flags


@pytest.mark.parametrize("write", [bvh, amass, joints, npz])
@pytest.mark.parametrize(
    ("up", "coordinates"),
    [("x", lambda x, y, z: (-y, x, z)), ("y", lambda *own: own), ("z", lambda x, y, z: (x, z, -y))],
)
def test_a_given_axis_is_taken_as_it_is(tmp_path, write, up, coordinates):
    """Of formats that infer it and of one whose axes are fixed."""
    own = STANDING["walks along z"]
    expected = np.stack(coordinates(*np.moveaxis(own.joint_positions, -1, 0)), axis=-1)
    motion = mk.read(write(own, tmp_path), up=up)
    assert_joints(motion, expected)
    if motion.local_rotations is not None:
        check_rotations(motion)


def test_only_three_axes_can_be_given(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'-y'"):
        mk.read(bvh(STANDING["stands elsewhere"], tmp_path), up="-y")
