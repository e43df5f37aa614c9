"""Motions as a table for retargeting to robots and imitation: pelvis first, z up, with velocities and contacts.

The first seven columns are those of Unitree's LAFAN1 Retargeting Dataset (XYZ, QXQYQZQW), whose other columns are a
robot's joint angles; here they are the input of retargeters: each joint's world position and rotation (GMR, README,
"Human/Robot Motion Data Formulation"), and foot contacts (ProtoMotions' key points). Axes are those of ROS' REP 103:
x forward, y left, z up.
Source: https://huggingface.co/datasets/unitreerobotics/LAFAN1_Retargeting_Dataset
"""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.fields.contact.bones import legs_of
from motionkit.fields.contact.detection import find_contacts, ground_of
from motionkit.io.retargeting import retarget
from motionkit.io.smpl_body import mean_shape_skeleton, rests_as_smpl

CONTACTS = ("left_foot_contact", "right_foot_contact")


def write_robot_csv(motion: Motion, path: Path) -> None:
    """Write the 22 joints' world positions (metres), rotations (x, y, z, w) and velocities (m/s; root: also rad/s).

    Identity rotations are a T-pose that faces x. Rotations of skeletons other than SMPL's are transferred to its rest
    pose (`retarget`). Velocities are central differences of the frames, contacts those that planting starts from.
    Raises `SkeletonMapError`.
    """
    fps = float(motion.fps)
    joints = map_joints(motion, SMPL22.name).astype(np.float64)
    paths = legs_of(SMPL22).foot_paths(joints)
    down = np.asarray(find_contacts(paths, fps, ground_of(paths, fps)).down.any(axis=-1))
    rotations, positions = _world_rotations(motion), _forward_left_up(joints)
    velocities = np.gradient(positions, 1.0 / fps, axis=0) if len(positions) > 1 else np.zeros_like(positions)
    columns: dict[str, Float64[np.ndarray, frames]] = {}
    for joint, name in enumerate(("root", *SMPL22.joint_names[1:])):
        groups = [
            ("x y z", positions[:, joint]),
            ("qx qy qz qw", np.roll(rotations[:, joint], -1, axis=-1)),
            ("vx vy vz", velocities[:, joint]),
        ]
        if joint == 0:
            groups.append(("wx wy wz", _angular_velocities(rotations[:, 0], fps)))
        for names, values in groups:
            columns.update({f"{name}_{each}": column for each, column in zip(names.split(), values.T, strict=True)})
    numbers = {name: column.astype(np.float32) for name, column in columns.items()}
    contacts = {name: foot.astype(np.uint8) for name, foot in zip(CONTACTS, down.T, strict=True)}
    pc.write_csv(pa.table({**numbers, **contacts, "time_seconds": motion.timegrid.seconds()}), path)


def _world_rotations(motion: Motion) -> Float64[np.ndarray, "frames 22 4"]:
    """World rotations of SMPL's joints relative to its T-pose, (w, x, y, z), with continuous signs."""
    body = motion if rests_as_smpl(motion) else retarget(motion, mean_shape_skeleton())
    assert body.local_rotations is not None
    world = kinematics.global_rotations(body.local_rotations.astype(np.float64), body.skeleton)[:, : SMPL22.num_joints]
    return kinematics.continuous_quaternions(
        np.concatenate((world[..., :1], _forward_left_up(world[..., 1:])), axis=-1)
    )


def _forward_left_up(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
    """(x, y, z) → (z, x, y): SMPL's T-pose looks along z, its left is x, y is up."""
    return np.roll(vectors, 1, axis=-1)


def _angular_velocities(rotations: Float64[np.ndarray, "frames 4"], fps: float) -> Float64[np.ndarray, "frames 3"]:
    # Between neighbouring frames; at the ends the frame itself.
    frames = np.arange(len(rotations))
    before, after = np.maximum(frames - 1, 0), np.minimum(frames + 1, len(rotations) - 1)
    steps = kinematics.quaternion_multiply(rotations[after], kinematics.quaternion_conjugate(rotations[before]))
    return np.asarray(kinematics.quaternion_to_rotation_vector(steps) * (fps / np.maximum(after - before, 1))[:, None])
