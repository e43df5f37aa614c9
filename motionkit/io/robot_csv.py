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
from motionkit.fields.contact.detection import find_contacts, ground_of
from motionkit.fields.contact.legs import legs_of
from motionkit.io.registry import Format
from motionkit.io.retargeting import retarget
from motionkit.io.smpl_body import mean_shape_skeleton, rests_as_smpl

PLACE, TURN = ("x", "y", "z"), ("qx", "qy", "qz", "qw")
VELOCITY, TURN_VELOCITY = ("vx", "vy", "vz"), ("wx", "wy", "wz")
CONTACTS = ("left_foot_contact", "right_foot_contact")
TIME = "time_seconds"

Column = Float64[np.ndarray, "frames"]


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
    turns = _turns(motion)
    places = _forward_left_up(joints)
    velocities, root_turning = _velocities(places, fps), _angular_velocities(turns[:, 0], fps)
    columns: dict[str, Column] = {}
    for joint, name in enumerate(("root", *SMPL22.joint_names[1:])):
        _add(columns, name, PLACE, places[:, joint])
        _add(columns, name, TURN, np.roll(turns[:, joint], -1, axis=-1))
        _add(columns, name, VELOCITY, velocities[:, joint])
        if joint == 0:
            _add(columns, name, TURN_VELOCITY, root_turning)
    whole = {name: foot.astype(np.uint8) for name, foot in zip(CONTACTS, down.T, strict=True)}
    numbers = {name: column.astype(np.float32) for name, column in columns.items()}
    pc.write_csv(pa.table({**numbers, **whole, TIME: motion.timegrid.seconds()}), path)


def _add(
    columns: dict[str, Column],
    joint: str,
    names: tuple[str, ...],
    values: Float64[np.ndarray, "frames numbers"],
) -> None:
    columns.update({f"{joint}_{name}": column for name, column in zip(names, values.T, strict=True)})


def _turns(motion: Motion) -> Float64[np.ndarray, "frames 22 4"]:
    """World rotations of SMPL's joints relative to its T-pose, (w, x, y, z), with continuous signs."""
    made = motion if rests_as_smpl(motion) else retarget(motion, mean_shape_skeleton())
    assert made.local_rotations is not None
    world = kinematics.global_rotations(made.local_rotations.astype(np.float64), made.skeleton)[:, : SMPL22.num_joints]
    turned = np.concatenate((world[..., :1], _forward_left_up(world[..., 1:])), axis=-1)
    return kinematics.continuous_quaternions(turned)


def _forward_left_up(vectors: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
    """(x, y, z) → (z, x, y): SMPL's T-pose looks along z, its left is x, y is up."""
    return np.roll(vectors, 1, axis=-1)


def _velocities(places: Float64[np.ndarray, "frames joints 3"], fps: float) -> Float64[np.ndarray, "frames joints 3"]:
    return np.asarray(np.gradient(places, 1.0 / fps, axis=0) if len(places) > 1 else np.zeros_like(places))


def _angular_velocities(turns: Float64[np.ndarray, "frames 4"], fps: float) -> Float64[np.ndarray, "frames 3"]:
    # Neighbouring frames; at the ends the frame itself.
    frames = np.arange(len(turns))
    before, after = np.maximum(frames - 1, 0), np.minimum(frames + 1, len(turns) - 1)
    steps = kinematics.quaternion_multiply(turns[after], kinematics.quaternion_conjugate(turns[before]))
    return np.asarray(kinematics.quaternion_to_rotation_vector(steps) * (fps / np.maximum(after - before, 1))[:, None])


FORMAT = Format(name="robot-csv", write=write_robot_csv, suffixes=(".csv",))
