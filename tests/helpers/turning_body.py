"""A body whose joints turn by up to half a radian a frame about fixed axes, along a random path."""

from fractions import Fraction

import numpy as np
from scipy.spatial.transform import Rotation

from motionkit.core import kinematics
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.timegrid import TimeGrid


def random_motion(
    seed: int, num_frames: int = 20, fps: Fraction = Fraction(30), rotations: bool = True, skeleton: Skeleton = SMPL22
) -> Motion:
    rng = np.random.default_rng(seed)
    joints = skeleton.num_joints
    turns = rng.uniform(-0.5, 0.5, (1, joints, 3)) * np.arange(num_frames)[:, None, None]
    turns = turns + rng.normal(size=(1, joints, 3))
    local = Rotation.from_rotvec(turns.reshape(-1, 3)).as_quat(scalar_first=True).reshape(num_frames, joints, 4)
    local = (local * rng.choice([-1, 1], (num_frames, joints, 1))).astype(np.float32)
    root = np.cumsum(rng.normal(scale=0.02, size=(num_frames, 3)), axis=0).astype(np.float32)
    return Motion(
        joint_positions=kinematics.forward_kinematics(local, root, skeleton),
        skeleton=skeleton,
        timegrid=TimeGrid(fps, num_frames, start_seconds=1.25),
        local_rotations=local if rotations else None,
        root_translation=root if rotations else None,
        captions=(Caption("a person turns"),),
        sequence_id="turn",
    )
