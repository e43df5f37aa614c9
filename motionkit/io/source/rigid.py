"""Rotations stored beside positions: kept if forward kinematics with rigid bones reproduces the positions."""

from dataclasses import replace

import numpy as np

from motionkit.core import kinematics
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float

# Tolerance of positions against those of the rotations.
RIGID_METRES = 0.002
# Tolerance of orthogonality of a rotation matrix.
MAX_MATRIX_ERROR = 0.01


def with_rotations(motion: Motion, local_matrices: Float[np.ndarray, "frames joints 3 3"]) -> Motion:
    """The motion with rotations, given as matrices relative to the parent, and the bones that fit them.

    If a matrix is not a rotation, or a position is missed by more than 2 mm, the motion is unchanged except for a line
    in its log.
    """
    error = float(np.abs(np.einsum("tjki,tjkl->tjil", local_matrices, local_matrices) - np.eye(3)).max())
    if error > MAX_MATRIX_ERROR or (np.linalg.det(local_matrices) < 0).any():
        return motion.logged(f"positions only: a matrix is off a rotation by {error:.2g}, or mirrors")
    local_rotations = kinematics.matrix_to_quaternion(local_matrices)
    skeleton, positions = motion.skeleton, motion.joint_positions
    above = skeleton.parents_or_self
    world = kinematics.global_rotations(local_rotations, skeleton)[:, above]
    bones = kinematics.quaternion_rotate(kinematics.quaternion_conjugate(world), positions - positions[:, above])
    offsets = np.median(bones, axis=0).astype(np.float32)
    offsets[0] = 0.0
    made = kinematics.quaternion_rotate(world, offsets) + positions[:, above]
    error = float(np.linalg.norm(made - positions, axis=-1)[:, 1:].max(initial=0.0))
    if error > RIGID_METRES:
        return motion.logged(f"positions only: the rotations put joints {1000 * error:.0f} mm from where they are")
    return replace(
        motion,
        skeleton=replace(skeleton, offsets=offsets),
        local_rotations=local_rotations.astype(np.float32),
        root_translation=positions[:, 0],
    )
