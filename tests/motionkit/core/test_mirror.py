"""Mirror images: positions by hand, rotations through forward kinematics."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Motion, mirror
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.timegrid import TimeGrid


def random_motion(skeleton: Skeleton, num_frames: int = 5) -> Motion:
    rng = np.random.default_rng(0)
    rotations = rng.normal(size=(num_frames, skeleton.num_joints, 4)).astype(np.float32)
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    root = rng.normal(size=(num_frames, 3)).astype(np.float32)
    positions = forward_kinematics(rotations, root, skeleton)
    return Motion(positions, skeleton, TimeGrid(Fraction(60), num_frames), rotations, root)


def test_left_and_right_change_places():
    motion = random_motion(SMPL22)
    mirrored = mirror(motion)
    left, right = SMPL22.index("left_wrist"), SMPL22.index("right_wrist")
    x, y, z = np.moveaxis(motion.joint_positions[:, right], -1, 0)
    assert np.array_equal(mirrored.joint_positions[:, left], np.stack((-x, y, z), axis=-1))
    assert np.array_equal(mirrored.joint_positions[:, 0], motion.joint_positions[:, 0] * np.float32([-1, 1, 1]))


def test_mirrored_rotations_give_the_mirrored_positions_on_an_asymmetric_body():
    offsets = SMPL22.offsets + np.random.default_rng(1).normal(scale=0.05, size=(22, 3)).astype(np.float32)
    skeleton = replace(SMPL22, offsets=offsets, end_sites=((20, (0.1, 0.0, 0.02)),))
    mirrored = mirror(random_motion(skeleton))
    again = forward_kinematics(mirrored.local_rotations, mirrored.root_translation, mirrored.skeleton)
    np.testing.assert_allclose(again, mirrored.joint_positions, atol=2e-6)
    assert mirrored.skeleton.end_sites == ((21, (-0.1, 0.0, 0.02)),)


@pytest.mark.parametrize("pairs", [(), ((4, 2),)])
def test_skeletons_that_cannot_be_mirrored(pairs):
    with pytest.raises(ValueError, match="joints"):
        mirror(random_motion(replace(SMPL22, left_right_pairs=pairs)))
