"""Swing-only bone rotations of the pose vectors, as 6D numbers.

Arrays are laid out [component, joint, frame], so that every operation runs along contiguous time.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float32, Int

from motionkit.features.layout import LAYOUTS

_NO_LENGTH = 1e-14


@dataclass(frozen=True, eq=False)
class BoneTree:
    """The bones of a layout, one per joint 1 … J − 1, named after the joint they end in.

    `start` is the joint a bone starts at; `previous` is the bone before it in its chain, or 0, the root, for the first
    bone of every chain, the arms' included; `direction` [3, J, 1] is the rest direction, Z+ for the root;
    `sideways` is a direction at right angles to it.
    """

    start: Int[np.ndarray, "bones"]
    previous: Int[np.ndarray, "bones"]
    direction: Float32[np.ndarray, "3 joints 1"]
    sideways: Float32[np.ndarray, "3 joints 1"]


@cache
def bone_tree(layout_name: str) -> BoneTree:
    """The bones of a layout in the published chains."""
    layout = LAYOUTS[layout_name]
    bones = sorted((chain[i], chain[i - 1], i) for chain in layout.chains for i in range(1, len(chain)))
    direction = np.array(layout.bone_directions, dtype=np.float32)
    direction[0] = (0, 0, 1)
    return BoneTree(
        start=np.array([start for _, start, _ in bones]),
        previous=np.array([start if place > 1 else 0 for _, start, place in bones]),
        direction=direction.T[:, :, None].copy(),
        sideways=np.roll(direction, 1, axis=1).T[:, :, None].copy(),
    )


def rotations_6d(
    joints: Float32[np.ndarray, "3 joints frames"], half_turn: Float32[np.ndarray, "frames"], tree: BoneTree
) -> Float32[np.ndarray, "bones 2 3 frames"]:
    """First two columns of each bone's rotation relative to the bone before it.

    A bone's world rotation is the shortest one from its rest direction u to its direction v, which is two reflections:
    R = I − g·s·sᵀ + 2·v·uᵀ with s = u + v half-way between them and g = 2 / |s|². The root's is a turn about Y by twice
    `half_turn` radians. A bone without length points along its rest direction; one that points the opposite way makes a
    half turn. Source: HumanML3D, common/skeleton.py (`inverse_kinematics_np`).
    """
    rest = tree.direction
    toward = np.empty_like(joints)
    np.subtract(joints[:, 1:], joints.take(tree.start, axis=1), out=toward[:, 1:])
    toward[:, 0] = np.sin(2 * half_turn), np.zeros_like(half_turn), np.cos(2 * half_turn)
    toward /= np.sqrt(_squared_length(toward, rest))
    middle = toward + rest
    middle[:, 0] = np.sin(half_turn), np.zeros_like(half_turn), np.cos(half_turn)
    gain = 2 / _squared_length(middle, tree.sideways)

    own, end, upright = middle[:, 1:], toward[:, 1:], rest[:, 1:]
    reflected = (-gain[1:] * own[:2])[:, None]
    columns = np.multiply(reflected, own)
    columns += (2 * upright[:2])[:, None] * end
    columns[0, 0] += 1
    columns[1, 1] += 1

    # Times the transpose of the rotation before: x − g·s·(s·x) + 2·u·(v·x).
    before, upright = tree.previous, rest[:, tree.previous]
    own, end = middle.take(before, axis=1), toward.take(before, axis=1)
    across = _dot(own, columns)
    across *= -gain.take(before, axis=0)
    along = _dot(end, columns)
    columns += own * across[:, None]
    columns += (2 * upright) * along[:, None]
    return np.asarray(columns.transpose(2, 0, 1, 3))


def _squared_length(
    vectors: Float32[np.ndarray, "3 joints frames"], fallback: Float32[np.ndarray, "3 joints 1"]
) -> Float32[np.ndarray, "joints frames"]:
    """Squared lengths; vectors without length are replaced by the fallback, a unit vector, in place."""
    squared = np.square(vectors[0])
    squared += vectors[1] * vectors[1]
    squared += vectors[2] * vectors[2]
    if squared.min() < _NO_LENGTH:
        empty = squared < _NO_LENGTH
        np.copyto(vectors, fallback, where=empty)
        squared[empty] = 1.0
    return np.asarray(squared)


def _dot(
    a: Float32[np.ndarray, "3 bones frames"], b: Float32[np.ndarray, "2 3 bones frames"]
) -> Float32[np.ndarray, "2 bones frames"]:
    result = np.multiply(a[0], b[:, 0])
    result += a[1] * b[:, 1]
    result += a[2] * b[:, 2]
    return np.asarray(result)
