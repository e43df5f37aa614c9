"""A body to look at: an octahedron along every bone and a small one at every joint, bound to the joints it touches.

Viewers show nodes only where something hangs on them, and Blender makes an armature only of joints that a skin uses.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float32, UInt16

from motionkit.skeleton import SMPL22, Skeleton
from motionkit.skeletons.mapping import SkeletonMapError, joint_map, rest_positions

Side = Literal["left", "right", "middle"]

# A bone is thickest at a sixth of its length, and as thick as Blender draws it.
WAIST, THICKNESS = 1 / 6, 0.1
JOINT_RADIUS_METRES = 0.015
SHORTEST_METRES = 1e-3
# Corners: start, four around the waist, tip. Faces are seen counter-clockwise from outside.
FACES = np.array([(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 1, 4), (5, 1, 2), (5, 2, 3), (5, 3, 4), (5, 4, 1)])


@dataclass(frozen=True, eq=False)
class BoneMesh:
    """Triangles of one side of the body in the rest pose, three vertices each, every vertex bound to one joint."""

    side: Side
    positions: Float32[np.ndarray, "vertices 3"]
    normals: Float32[np.ndarray, "vertices 3"]
    joints: UInt16[np.ndarray, "vertices"]


@dataclass(frozen=True, eq=False)
class _Octahedron:
    corners: Float32[np.ndarray, "6 3"]
    joints: tuple[int, ...]
    side: Side


def bone_meshes(skeleton: Skeleton) -> list[BoneMesh]:
    """One mesh for each side of the body that has joints; metres.

    A bone's tip is bound to the joint that it ends in, all else to the joint that it starts from: so tips stay at their
    joints also where bones change their length.
    """
    rest = rest_positions(skeleton)
    sides = _sides(skeleton)
    solids = [_ball(place, joint, sides[joint]) for joint, place in enumerate(rest)]
    bones = [(parent, joint, rest[joint]) for joint, parent in enumerate(skeleton.parents) if parent >= 0]
    bones += [(joint, joint, rest[joint] + np.array(tip, np.float32)) for joint, tip in skeleton.end_sites]
    for start, end, tip in bones:
        if np.linalg.norm(tip - rest[start]) > SHORTEST_METRES:
            solids.append(_bone(rest[start], tip, (start, end), sides[end]))
    names: tuple[Side, ...] = ("left", "right", "middle")
    by_side = {side: [solid for solid in solids if solid.side == side] for side in names}
    return [_mesh(side, chosen) for side, chosen in by_side.items() if chosen]


def _sides(skeleton: Skeleton) -> list[Side]:
    """The side of each joint by the skeleton's pairs, else by the joints of the 22 that it is; children go with it."""
    sides: list[Side] = ["middle"] * skeleton.num_joints
    for left, right in skeleton.left_right_pairs or _mapped_pairs(skeleton):
        sides[left], sides[right] = "left", "right"
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0 and sides[joint] == "middle":
            sides[joint] = sides[parent]
    return sides


def _mapped_pairs(skeleton: Skeleton) -> list[tuple[int, int]]:
    try:
        chief = joint_map(skeleton, SMPL22.name).weights.argmax(axis=1).tolist()
    except SkeletonMapError:
        return []
    return [(chief[left], chief[right]) for left, right in SMPL22.left_right_pairs if chief[left] != chief[right]]


def _ball(place: Float32[np.ndarray, "3"], joint: int, side: Side) -> _Octahedron:
    up = np.array([0, JOINT_RADIUS_METRES, 0], np.float32)
    return _Octahedron(_corners(place - up, place + up, 0.5, JOINT_RADIUS_METRES), (joint,) * 6, side)


def _bone(
    start: Float32[np.ndarray, "3"], tip: Float32[np.ndarray, "3"], joints: tuple[int, int], side: Side
) -> _Octahedron:
    radius = THICKNESS * float(np.linalg.norm(tip - start))
    return _Octahedron(_corners(start, tip, WAIST, radius), (*(joints[0],) * 5, joints[1]), side)


def _corners(
    start: Float32[np.ndarray, "3"], tip: Float32[np.ndarray, "3"], waist: float, radius: float
) -> Float32[np.ndarray, "6 3"]:
    along = (tip - start) / np.linalg.norm(tip - start)
    # Any axis that is not nearly parallel will do.
    first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    first /= np.linalg.norm(first)
    second = np.cross(along, first)
    ring = start + waist * (tip - start) + radius * np.stack((first, second, -first, -second))
    return np.concatenate((start[None], ring, tip[None])).astype(np.float32)


def _mesh(side: Side, solids: list[_Octahedron]) -> BoneMesh:
    triangles = np.concatenate([solid.corners[FACES] for solid in solids])
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = across / np.linalg.norm(across, axis=-1, keepdims=True)
    joints = np.concatenate([np.array(solid.joints, np.uint16)[FACES] for solid in solids])
    return BoneMesh(side, triangles.reshape(-1, 3), np.repeat(normals, 3, axis=0).astype(np.float32), joints.ravel())
