"""Swing-only bone rotations of the pose vectors, as 6D numbers.

Arrays have the shape [component, joint, frame], so that every operation runs along contiguous time.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from motionkit.core.shapes import Float32, Int
from motionkit.features.layout import LAYOUTS

_NO_LENGTH = 1e-14
# The terms of conj(a)·b after a_w·b: component, factor of a, factor of b, whether the term is added.
_CONJUGATE_PRODUCT = (
    *((0, 1, 1, True), (0, 2, 2, True), (0, 3, 3, True)),
    *((1, 1, 0, False), (1, 2, 3, False), (1, 3, 2, True)),
    *((2, 2, 0, False), (2, 3, 1, False), (2, 1, 3, True)),
    *((3, 3, 0, False), (3, 1, 2, False), (3, 2, 1, True)),
)


@dataclass(frozen=True, eq=False)
class BoneTree:
    """The bones of a layout, one per joint 1 … J − 1, named after the joint they end in.

    `start` is the joint a bone starts at; `previous` is the bone before it in its chain, or 0, the root, for the first
    bone of every chain, the arms' included; `direction` [3, J, 1] is the rest direction u, along an axis, Z+ for the
    root; `sideways` is an axis perpendicular to it. Since u is along an axis, element i of the quaternion
    (u·v, u × v) of a direction v, flattened over components and joints, is element `source[i]` of v times `sign[i]`.
    `runs` are (joints, parents) as slices, with every parent before its children.
    """

    runs: tuple[tuple[slice, slice], ...]
    start: Int[np.ndarray, "bones"]
    previous: Int[np.ndarray, "bones"]
    direction: Float32[np.ndarray, "3 joints 1"]
    sideways: Float32[np.ndarray, "3 joints 1"]
    source: Int[np.ndarray, "numbers"]
    sign: Float32[np.ndarray, "numbers 1"]


@cache
def bone_tree(layout_name: str) -> BoneTree:
    """The bones of a layout in the published chains."""
    layout = LAYOUTS[layout_name]
    bones = sorted((chain[i], chain[i - 1], i) for chain in layout.chains for i in range(1, len(chain)))
    direction = np.array(layout.bone_directions, dtype=np.float32)
    direction[0] = (0, 0, 1)
    # [joint, quaternion component, component of v]: the linear map v → (u·v, u × v), at most one element per row.
    product = np.stack((direction, *np.cross(direction[:, None], np.eye(3)).transpose(2, 0, 1)), axis=1)
    place = np.abs(product).argmax(axis=2)
    sign = np.take_along_axis(product, place[:, :, None], axis=2)[:, :, 0]
    source = place * len(direction) + np.arange(len(direction))[:, None]
    return BoneTree(
        runs=_runs([start for _, start, _ in bones]),
        start=np.array([start for _, start, _ in bones]),
        previous=np.array([start if place > 1 else 0 for _, start, place in bones]),
        direction=direction.T[:, :, None].copy(),
        sideways=np.roll(direction, 2, axis=1).T[:, :, None].copy(),
        source=source.T.reshape(-1),
        sign=sign.T.reshape(-1, 1).astype(np.float32),
    )


def _runs(starts: list[int]) -> tuple[tuple[slice, slice], ...]:
    """Runs of consecutive joints whose parents are consecutive, or one joint, and outside the run."""
    runs: list[tuple[slice, slice]] = []
    joint = 1
    while joint <= len(starts):
        parents = starts[joint - 1 :]
        in_a_row = next((i for i, parent in enumerate(parents) if parent != parents[0] + i), len(parents))
        in_a_row = min(in_a_row, joint - parents[0])
        alike = next((i for i, parent in enumerate(parents) if parent != parents[0]), len(parents))
        length = max(in_a_row, alike)
        above = slice(parents[0], parents[0] + (in_a_row if in_a_row >= alike else 1))
        runs.append((slice(joint, joint + length), above))
        joint += length
    return tuple(runs)


def rotations_6d(
    joints: Float32[np.ndarray, "3 joints frames"],
    half_turn: Float32[np.ndarray, "frames"],
    tree: BoneTree,
    out: Float32[np.ndarray, "bones 6 frames"],
) -> None:
    """Write the first two columns of each bone's rotation relative to the previous bone.

    A bone's world rotation is the shortest one from its rest direction u to its direction v: the quaternion
    (1 + u·v, u × v). The root's is a rotation about Y by twice `half_turn` radians. A bone of length zero points along
    its rest direction; one that points the opposite way is rotated by 180°. Source: HumanML3D, common/skeleton.py
    (`inverse_kinematics_np`).
    """
    toward = np.empty_like(joints)
    toward[:, 0] = tree.direction[:, 0]
    np.subtract(joints[:, 1:], joints.take(tree.start, axis=1), out=toward[:, 1:])
    length = _squared_length(toward, tree.direction)
    toward /= np.sqrt(length, out=length)
    world = toward.reshape(-1, toward.shape[2]).take(tree.source, axis=0)
    world *= tree.sign
    world = world.reshape(4, *toward.shape[1:])
    world[0] += 1
    world[:, 0] = 0
    world[0, 0], world[2, 0] = np.cos(half_turn), np.sin(half_turn)
    squared = _squared_length(world[1:], tree.sideways, start=world[0])
    relative = _relative(world.take(tree.previous, axis=1), world[:, 1:])
    _fill_columns(relative, 2 / (squared.take(tree.previous, axis=0) * squared[1:]), out)


def _squared_length(
    vectors: Float32[np.ndarray, "3 joints frames"],
    fallback: Float32[np.ndarray, "3 joints 1"],
    start: Float32[np.ndarray, "joints frames"] | None = None,
) -> Float32[np.ndarray, "joints frames"]:
    """Squared lengths of vectors, or of quaternions if their real parts are given as `start`.

    Zero vectors are replaced by the fallback, a unit vector, in place.
    """
    squared = np.square(vectors[0])
    squared += np.square(vectors[1])
    squared += np.square(vectors[2])
    if start is not None:
        squared += np.square(start)
    if squared.min() < _NO_LENGTH:
        empty = squared < _NO_LENGTH
        np.copyto(vectors, fallback, where=empty)
        squared[empty] = 1.0
    return np.asarray(squared)


def _relative(
    before: Float32[np.ndarray, "4 bones frames"], own: Float32[np.ndarray, "4 bones frames"]
) -> Float32[np.ndarray, "4 bones frames"]:
    """The quaternion product of the conjugate of `before` and `own`."""
    result = before[0] * own
    product = np.empty_like(result[0])
    for component, i, j, add in _CONJUGATE_PRODUCT:
        np.multiply(before[i], own[j], out=product)
        (np.add if add else np.subtract)(result[component], product, out=result[component])
    return np.asarray(result)


def _fill_columns(
    quaternions: Float32[np.ndarray, "4 bones frames"],
    gain: Float32[np.ndarray, "bones frames"],
    out: Float32[np.ndarray, "bones 6 frames"],
) -> None:
    """Write the first two columns of the rotation matrices of quaternions; `gain` is 2 over their squared length."""
    w, x, y, z = quaternions
    gain_x, gain_y, gain_z = gain * quaternions[1:]
    xy, zw = gain_x * y, gain_z * w
    zz = gain_z * z
    np.subtract(1, gain_y * y + zz, out=out[:, 0])
    np.add(xy, zw, out=out[:, 1])
    np.subtract(gain_x * z, gain_y * w, out=out[:, 2])
    np.subtract(xy, zw, out=out[:, 3])
    np.subtract(1, gain_x * x + zz, out=out[:, 4])
    np.add(gain_y * z, gain_x * w, out=out[:, 5])
