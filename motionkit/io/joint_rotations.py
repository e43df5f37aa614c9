"""Local rotations on rigid bones: read beside positions, or computed for animation files by inverse kinematics."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.contact.bones import Bones

# Tolerance of positions against those of rotations on rigid bones. Animators expect such bones; above this error every
# joint gets a translation of its own instead.
RIGID_METRES = 2e-3
BONE_SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class JointChannels:
    """A motion on a skeleton: rotations of all joints, translations (metres, in the parent's frame) of some.

    The root always has a translation, its world position. The other joints rest at their offsets.
    """

    skeleton: Skeleton
    rotations: Float32[np.ndarray, "frames joints 4"]
    translations: Mapping[int, Float32[np.ndarray, "frames 3"]]


def joint_channels(motion: Motion) -> JointChannels:
    """The motion's rotations if it has them; else those of inverse kinematics on its bones.

    If rigid bones would miss a position by more than 2 mm, every joint gets a translation, so that forward kinematics
    always gives the positions.
    """
    if motion.local_rotations is not None and motion.root_translation is not None:
        return JointChannels(motion.skeleton, motion.local_rotations, {0: motion.root_translation})
    positions = motion.joint_positions
    skeleton = _with_observed_bones(motion)
    rotations = kinematics.inverse_kinematics(positions, skeleton)
    places = {0: positions[:, 0]}
    reached = kinematics.forward_kinematics(rotations, positions[:, 0], skeleton)
    if np.abs(reached - positions).max() <= RIGID_METRES:
        return JointChannels(skeleton, rotations, places)
    world = kinematics.global_rotations(rotations, skeleton)
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        back = kinematics.quaternion_conjugate(world[:, parent])
        places[joint] = kinematics.quaternion_rotate(back, positions[:, joint] - positions[:, parent])
    return JointChannels(skeleton, rotations, places)


def _with_observed_bones(motion: Motion) -> Skeleton:
    """The skeleton with the motion's own bones, rotated to their rest directions."""
    skeleton = motion.skeleton
    some = np.unique(np.linspace(0, motion.num_frames - 1, BONE_SAMPLES).astype(np.int64))
    bones = Bones.of(motion.joint_positions[some], skeleton)
    rest = skeleton.offsets.astype(np.float64)
    own = rest.copy()
    for joint in range(skeleton.num_joints):
        children = [
            child
            for child in skeleton.children(joint)
            if child not in bones.moving and np.any(np.abs(rest[child]) > 1e-6)
        ]
        if len(children) == 1:
            length = np.linalg.norm(bones.offsets[children[0]])
            own[children] *= length / np.linalg.norm(rest[children[0]])
        elif children:
            turn = kinematics.fit_rotation(bones.offsets[children], rest[None, children])
            own[children] = kinematics.quaternion_rotate(turn, bones.offsets[children])
    return replace(skeleton, offsets=own.astype(np.float32))


# Tolerance of orthogonality of a rotation matrix, and of the sum of the squares of its six numbers, which is 2.
MAX_MATRIX_ERROR, MAX_SQUARES_ERROR = 0.01, 0.5


def matrices_of(
    sixes: Float[np.ndarray, "frames numbers"], form: Literal["rows", "columns", "pairs"], path: Path
) -> Float64[np.ndarray, "frames joints 3 3"]:
    """Rotation matrices of 6 numbers a joint, by Gram-Schmidt: two rows, two columns, or the columns' numbers in turn.

    Raises `FormatError` (`unit`) if most are far from rotations, as normalised ones are.
    """
    squares = float(np.median(np.square(sixes).reshape(-1, 6).sum(axis=1)))
    if abs(squares - 2.0) > MAX_SQUARES_ERROR:
        message = f"the squares of a rotation's six numbers sum to {squares:.3g}, expected 2: multiply normalised "
        raise FormatError(f"{message}vectors by their std and add the mean", path=path, reason="unit")
    if form == "pairs":
        sixes = sixes.reshape(len(sixes), -1, 3, 2).swapaxes(-1, -2).reshape(sixes.shape)
    matrices = kinematics.closest_rotations(sixes)
    # The rows of a matrix are the columns of its inverse.
    return np.asarray(matrices.swapaxes(-1, -2)) if form == "rows" else matrices


def with_rotations(
    motion: Motion, matrices: Float[np.ndarray, "frames joints 3 3"], *, is_global: bool = False
) -> Motion:
    """The motion with rotations, given as matrices relative to the parent or the world, and the bones that fit them.

    If a matrix is not a rotation, or a position is missed by more than 2 mm, the motion is unchanged except for a line
    in its log.
    """
    error = float(np.abs(np.einsum("tjki,tjkl->tjil", matrices, matrices) - np.eye(3)).max())
    if error > MAX_MATRIX_ERROR or (np.linalg.det(matrices) < 0).any():
        return motion.logged(f"positions only: a matrix is off a rotation by {error:.2g}, or mirrors")
    skeleton, positions = motion.skeleton, motion.joint_positions
    above = skeleton.parents_or_self
    if is_global:
        matrices = np.concatenate((matrices[:, :1], (matrices[:, above].swapaxes(-1, -2) @ matrices)[:, 1:]), axis=1)
    local_rotations = kinematics.matrix_to_quaternion(matrices)
    world = kinematics.global_rotations(local_rotations, skeleton)[:, above]
    bones = kinematics.quaternion_rotate(kinematics.quaternion_conjugate(world), positions - positions[:, above])
    offsets = np.median(bones, axis=0).astype(np.float32)
    offsets[0] = 0.0
    rigid = kinematics.quaternion_rotate(world, offsets) + positions[:, above]
    error = float(np.linalg.norm(rigid - positions, axis=-1)[:, 1:].max(initial=0.0))
    if error > RIGID_METRES:
        return motion.logged(f"positions only: the rotations put joints {1000 * error:.0f} mm from where they are")
    return replace(
        motion,
        skeleton=replace(skeleton, offsets=offsets),
        local_rotations=local_rotations.astype(np.float32),
        root_translation=positions[:, 0],
    )
