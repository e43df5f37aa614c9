"""Joint positions on one skeleton: bones that keep their length, and joints that several bones hang on their shape."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64

from motionkit.core.kinematics import fit_rotation, quaternion_conjugate, quaternion_rotate
from motionkit.core.skeleton import Skeleton

# A joint whose distance from its parent spreads by more hangs on no bone: hips above a reference on the floor, markers.
TRAVELLING_FROM_ROOT_METRES, TRAVELLING_METRES = 0.25, 0.5
NO_LENGTH = 1e-6
RIGID_SHARE, RIGID_METRES = 0.05, 0.003


@dataclass(frozen=True, eq=False)
class Bones:
    """A body's own bones: of every joint the place in its parent's frame, which a joint with one child has along Y.

    `moving` joints hang on no bone, and stay where they are.
    """

    skeleton: Skeleton
    offsets: Float64[np.ndarray, "joints 3"]
    moving: frozenset[int]

    @classmethod
    def of(cls, positions: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton) -> "Bones":
        """The bones of some frames: median lengths, and between the bones of one joint the angles that fit best."""
        values = positions.astype(np.float64)
        parents = [max(parent, 0) for parent in skeleton.parents]
        bones = values - values[:, parents]
        lengths = np.linalg.norm(bones, axis=-1)
        middle = np.median(lengths, axis=0)
        spread = np.quantile(lengths, 0.95, axis=0) - np.quantile(lengths, 0.05, axis=0)
        limits = [TRAVELLING_FROM_ROOT_METRES if parent == 0 else TRAVELLING_METRES for parent in parents]
        moving = frozenset(np.flatnonzero((spread > limits) | (middle < NO_LENGTH)).tolist()) - {0}
        offsets = np.zeros((skeleton.num_joints, 3))
        offsets[:, 1] = middle
        for joint in range(skeleton.num_joints):
            children = [child for child in skeleton.children(joint) if child not in moving]
            if len(children) > 1:
                offsets[children] = _shape(bones[:, children], middle[children])
        return cls(skeleton, offsets, moving)

    @classmethod
    def lacking(cls, positions: Float[np.ndarray, "frames joints 3"], skeleton: Skeleton) -> "Bones | None":
        """The bones that positions are to be brought onto; None where they keep their length to some 5 %, as it is."""
        found = cls.of(positions, skeleton)
        children = [child for child, parent in enumerate(skeleton.parents) if parent >= 0 and child not in found.moving]
        lengths = _lengths(positions[:, children] - positions[:, [skeleton.parents[child] for child in children]])
        spread = np.quantile(lengths, 0.95, axis=0) - np.quantile(lengths, 0.05, axis=0)
        return found if bool((spread > RIGID_SHARE * np.median(lengths, axis=0) + RIGID_METRES).any()) else None

    def applied(self, positions: Float32[np.ndarray, "frames joints 3"]) -> Float32[np.ndarray, "frames joints 3"]:
        """The poses with these bones, each joint as near as its bone lets it to where it is, from the root on."""
        wanted = np.ascontiguousarray(positions.transpose(1, 0, 2), dtype=np.float64)
        reached = wanted.copy()
        for joint in range(self.skeleton.num_joints):
            children = [child for child in self.skeleton.children(joint) if child not in self.moving]
            if len(children) > 1:
                reached[children] = reached[joint] + _placed(self.offsets[children], wanted[children] - reached[joint])
            elif children:
                bone, own = wanted[children[0]] - reached[joint], self.offsets[children[0], 1]
                reached[children[0]] = reached[joint] + bone * (own / np.maximum(_lengths(bone), NO_LENGTH))[:, None]
        return reached.transpose(1, 0, 2).astype(np.float32)


def _shape(
    bones: Float64[np.ndarray, "frames bones 3"], lengths: Float64[np.ndarray, "bones"]
) -> Float64[np.ndarray, "bones 3"]:
    """The mean of several bones of one joint, turned onto one another, with the given lengths."""
    shape = bones[len(bones) // 2]
    for _ in range(3):
        turns = fit_rotation(np.broadcast_to(shape, bones.shape), bones)
        shape = np.median(quaternion_rotate(quaternion_conjugate(turns)[:, None], bones), axis=0)
        shape = shape * (lengths / np.maximum(np.linalg.norm(shape, axis=-1), NO_LENGTH))[:, None]
    return np.asarray(shape)


def _placed(
    shape: Float64[np.ndarray, "bones 3"], wanted: Float64[np.ndarray, "bones frames 3"]
) -> Float64[np.ndarray, "bones frames 3"]:
    """A shape turned onto bones by least squares."""
    bones = wanted.transpose(1, 0, 2)
    turns = fit_rotation(np.broadcast_to(shape, bones.shape), bones)
    return np.asarray(quaternion_rotate(turns[:, None], shape).transpose(1, 0, 2))


def _lengths(vectors: Float[np.ndarray, "*shape 3"]) -> Float64[np.ndarray, "*shape"]:
    return np.asarray(np.linalg.norm(vectors.astype(np.float64), axis=-1))
