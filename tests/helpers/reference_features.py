"""The published pose vector written out plainly, one frame and one bone at a time, with scipy's rotations."""

from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from motionkit.features.layout import PoseLayout


def shortest(u: np.ndarray, v: np.ndarray) -> Rotation:
    axis = np.cross(u, v)
    angle = np.arctan2(np.linalg.norm(axis), np.dot(u, v))
    return Rotation.from_rotvec(axis / (np.linalg.norm(axis) or 1.0) * angle)


def plain_vectors(joints: np.ndarray, body: PoseLayout) -> np.ndarray:
    joints = joints.astype(np.float64)
    facing = body.facing
    forward = []
    for pose in joints:
        across = (pose[facing.left_hip] - pose[facing.right_hip]) + (
            pose[facing.right_shoulder] - pose[facing.left_shoulder]
        )
        forward.append(np.cross([0, 1, 0], across / np.linalg.norm(across)))
    smooth = gaussian_filter1d(np.array(forward), 20, axis=0, mode="nearest")
    heading = [shortest(direction / np.linalg.norm(direction), np.array([0.0, 0, 1])) for direction in smooth]
    heading[0] = Rotation.identity()
    rows = []
    for t in range(len(joints) - 1):
        between = (heading[t + 1] * heading[t].inv()).as_quat(canonical=True)
        step = joints[t + 1] - joints[t]
        root_step = heading[t + 1].apply(step[0])
        relative = heading[t].apply(joints[t] - joints[t, 0] * [1, 0, 1])
        rotations = np.zeros((body.num_joints, 6))
        for chain in body.chains:
            above = heading[t]
            for start, end in pairwise(chain):
                world = shortest(np.array(body.bone_directions[end], float), joints[t, end] - joints[t, start])
                local = (above.inv() * world).as_matrix()
                rotations[end] = np.concatenate((local[:, 0], local[:, 1]))
                above = world
        contacts = [float(np.sum(step[foot] ** 2) < body.contact_threshold) for foot in body.contact_joints]
        rows.append(
            np.concatenate(
                (
                    [np.arcsin(between[1]), root_step[0], root_step[2], joints[t, 0, 1]],
                    relative[1:].ravel(),
                    rotations[1:].ravel(),
                    heading[t].apply(step).ravel(),
                    contacts,
                )
            )
        )
    return np.array(rows)
