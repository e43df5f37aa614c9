"""Small joint displacements applied by rotating bones, which keeps bone lengths and the shapes of several bones."""

import numpy as np

from motionkit.core.kinematics import quaternion_between, quaternion_rotate, rotation_vector_to_quaternion
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.joints import turned_rotations
from motionkit.fields.motion_field import Poses

_NO_LENGTH = 1e-9


def displaced(poses: Poses, steps: Float64[np.ndarray, "times joints 3"], skeleton: Skeleton) -> Poses:
    """Moves every joint by `steps` (m), as far as its bone from the displaced parent allows."""
    old = np.ascontiguousarray(poses.joint_positions.transpose(1, 0, 2), dtype=np.float64)
    wanted = old + steps.transpose(1, 0, 2)
    reached = wanted.copy()
    turned: dict[int, Float64[np.ndarray, "times 4"]] = {}
    for joint in range(skeleton.num_joints):
        children = list(skeleton.children(joint))
        if not children:
            continue
        bones, aims = old[children] - old[joint], wanted[children] - reached[joint]
        if len(children) > 1:
            turned[joint] = _turn(bones, aims)
            reached[children] = reached[joint] + quaternion_rotate(turned[joint][None], bones)
            continue
        length, aim = (np.linalg.norm(each[0], axis=-1, keepdims=True) for each in (bones, aims))
        reached[children[0]] = reached[joint] + aims[0] * (length / np.maximum(aim, _NO_LENGTH))
        if poses.local_rotations is not None:
            turned[joint] = quaternion_between(bones[0], aims[0])
    rotations, translation = poses.local_rotations, poses.root_translation
    if rotations is not None:
        rotations = turned_rotations(rotations, turned, skeleton)
    if translation is not None:
        translation = translation + steps[:, 0].astype(np.float32)
    return Poses(reached.transpose(1, 0, 2).astype(np.float32), rotations, translation)


def _turn(
    bones: Float64[np.ndarray, "bones times 3"], aims: Float64[np.ndarray, "bones times 3"]
) -> Float64[np.ndarray, "times 4"]:
    """The small rotation that best aligns bones with their targets: least squares, linear in the angle."""
    squares = np.einsum("bti,bti->t", bones, bones)
    spread = (squares * (1.0 + 1e-9) + _NO_LENGTH)[:, None, None] * np.eye(3) - np.einsum("bti,btj->tij", bones, bones)
    torque = np.cross(bones, aims).sum(axis=0)
    return rotation_vector_to_quaternion(np.linalg.solve(spread, torque[..., None])[..., 0])
