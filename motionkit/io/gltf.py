"""glTF 2.0 binary (.glb): a skinned skeleton with one animation at the motion's own frames, for viewers and engines.

Nodes are joints, metres, y up. Rotations (and the root's translation) have a key at every frame; octahedra make the
bones visible. `asset.extras` holds what glTF has no field for: the exact framerate, captions, licence.
Source: Khronos, glTF 2.0 specification, §3.7.3 (skins) and §3.11 (animations).
"""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motionkit.core.framerate import format_fps
from motionkit.core.kinematics import continuous_quaternions
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, UInt16
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map, rest_positions
from motionkit.core.timegrid import TimeGrid
from motionkit.io.registry import Format
from motionkit.io.source.joint_channels import JointChannels, joint_channels

Side = Literal["left", "right", "middle"]

# A bone is thickest at a sixth of its length, with the thickness of Blender's bones.
WAIST, THICKNESS = 1 / 6, 0.1
JOINT_RADIUS_METRES = 0.015
SHORTEST_METRES = 1e-3
# Vertices: start, four around the waist, tip. Faces are counter-clockwise seen from outside.
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

    A bone's tip is bound to its end joint, its other vertices to its start joint, so that tips stay at their joints if
    bones change length.
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
    """The side of each joint by the skeleton's pairs, else by its map to the 22 joints; children inherit it."""
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
    # Any axis that is not nearly parallel.
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


MAGIC, VERSION = 0x46546C67, 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
COMPONENT_TYPES = {"float32": 5126, "uint16": 5123}
WIDTHS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
VERTICES = 34962


class GlbBuffer:
    """Collects arrays into one buffer, each aligned to four bytes; owns the bytes and their descriptions.

    It can extend the buffer of another file, given with its views and accessors.
    """

    def __init__(
        self, content: bytes = b"", views: Sequence[dict[str, Any]] = (), accessors: Sequence[dict[str, Any]] = ()
    ) -> None:
        self._content = bytearray(content) + bytes(-len(content) % 4)
        self._views = list(views)
        self._accessors = list(accessors)

    def add(self, array: np.ndarray, *, bounds: bool = False, vertices: bool = False) -> int:
        """Append float32 or uint16 values, one element per row; returns the accessor's index.

        `bounds` adds minimum and maximum (required for positions and key times), `vertices` marks vertex data. Raises
        `KeyError` for another type or width.
        """
        rows = np.ascontiguousarray(array.reshape(len(array), -1))
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._content), "byteLength": rows.nbytes}
        if vertices:
            view["target"] = VERTICES
        accessor: dict[str, Any] = {
            "bufferView": len(self._views),
            "componentType": COMPONENT_TYPES[rows.dtype.name],
            "count": len(rows),
            "type": WIDTHS[rows.shape[1]],
        }
        if bounds:
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self._content += rows.astype(rows.dtype.newbyteorder("<"), copy=False).tobytes()
        self._content += bytes(-len(self._content) % 4)
        self._views.append(view)
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def write(self, path: Path, document: dict[str, Any]) -> None:
        """Write the .glb: `document` completed by the buffer, its views and accessors."""
        complete = {
            **document,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._content)}],
        }
        text = json.dumps(complete, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(self._content)
        with path.open("wb") as file:
            file.write(struct.pack("<III", MAGIC, VERSION, size))
            file.write(struct.pack("<II", len(text), JSON_CHUNK) + text)
            file.write(struct.pack("<II", len(self._content), BINARY_CHUNK) + self._content)


COLOURS = {"left": (0.16, 0.42, 0.85, 1.0), "right": (0.90, 0.38, 0.12, 1.0), "middle": (0.55, 0.55, 0.58, 1.0)}
# (x, y, z, w)
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0], np.float32)


def write_gltf(motion: Motion, path: Path) -> None:
    """Write one motion as .glb; the first frame is at 0 s, keys are interpolated linearly (rotations by SLERP).

    A motion without rotations gets them by inverse kinematics, and translations if rigid bones would miss its positions
    (`joint_channels`). Key times are float32, as glTF requires: exact to a thousandth of a frame for the first 16,000
    frames, and to half a frame for 8 million.
    """
    channels = joint_channels(motion)
    buffer = GlbBuffer()
    num_joints = channels.skeleton.num_joints
    meshes = bone_meshes(channels.skeleton)
    document = {
        "asset": {"version": "2.0", "generator": "motionkit", "extras": _extras(motion)},
        "scene": 0,
        "scenes": [{"nodes": [0, num_joints]}],
        "nodes": [*_nodes(channels.skeleton), {"name": "body", "mesh": 0, "skin": 0}],
        "meshes": [{"name": "body", "primitives": [_primitive(mesh, i, buffer) for i, mesh in enumerate(meshes)]}],
        "materials": [_material(mesh) for mesh in meshes],
        "skins": [_skin(channels.skeleton, buffer)],
        "animations": [_animation(motion, channels, buffer)],
    }
    buffer.write(path, document)


def _nodes(skeleton: Skeleton) -> list[dict[str, Any]]:
    nodes: list[dict[str, Any]] = []
    for joint, name in enumerate(skeleton.joint_names):
        node: dict[str, Any] = {"name": name, "translation": skeleton.offsets[joint].tolist()}
        if children := skeleton.children(joint):
            node["children"] = list(children)
        nodes.append(node)
    return nodes


def _skin(skeleton: Skeleton, buffer: GlbBuffer) -> dict[str, Any]:
    # Rest rotations are identities, so an inverse bind matrix is a translation to the origin; in column-major order.
    inverse = np.tile(np.eye(4, dtype=np.float32), (skeleton.num_joints, 1, 1))
    inverse[:, 3, :3] = -rest_positions(skeleton)
    return {"joints": list(range(skeleton.num_joints)), "skeleton": 0, "inverseBindMatrices": buffer.add(inverse)}


def _primitive(mesh: BoneMesh, material: int, buffer: GlbBuffer) -> dict[str, Any]:
    joints = np.zeros((len(mesh.joints), 4), np.uint16)
    joints[:, 0] = mesh.joints
    weights = np.zeros((len(mesh.joints), 4), np.float32)
    weights[:, 0] = 1.0
    attributes = {
        "POSITION": buffer.add(mesh.positions, bounds=True, vertices=True),
        "NORMAL": buffer.add(mesh.normals, vertices=True),
        "JOINTS_0": buffer.add(joints, vertices=True),
        "WEIGHTS_0": buffer.add(weights, vertices=True),
    }
    return {"attributes": attributes, "material": material}


def _material(mesh: BoneMesh) -> dict[str, Any]:
    surface = {"baseColorFactor": COLOURS[mesh.side], "metallicFactor": 0.0, "roughnessFactor": 0.8}
    return {"name": mesh.side, "pbrMetallicRoughness": surface}


def _animation(motion: Motion, channels: JointChannels, buffer: GlbBuffer) -> dict[str, Any]:
    seconds = TimeGrid(motion.fps, motion.num_frames).seconds().astype(np.float32)
    keys = buffer.add(seconds, bounds=True)
    rotations = continuous_quaternions(channels.rotations.astype(np.float64))
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    turned = rotations[..., [1, 2, 3, 0]].astype(np.float32)
    moved = [joint for joint in range(channels.skeleton.num_joints) if not (turned[:, joint] == IDENTITY).all()]
    values = [(joint, "translation", place) for joint, place in channels.translations.items()]
    values += [(joint, "rotation", turned[:, joint]) for joint in moved]
    samplers = [{"input": keys, "output": buffer.add(value), "interpolation": "LINEAR"} for _, _, value in values]
    targets = [
        {"sampler": number, "target": {"node": joint, "path": kind}} for number, (joint, kind, _) in enumerate(values)
    ]
    return {"name": motion.sequence_id or "motion", "samplers": samplers, "channels": targets}


def _extras(motion: Motion) -> dict[str, Any]:
    provenance = motion.provenance
    said = {
        "sequence_id": motion.sequence_id,
        "fps": format_fps(motion.fps),
        "start_seconds": motion.timegrid.start_seconds,
        "action": motion.action,
        "style": motion.style,
        "source": provenance.source,
        "licence": provenance.licence,
        "captions": [
            {"text": caption.text, "start_seconds": caption.start_seconds, "end_seconds": caption.end_seconds}
            for caption in motion.captions
        ],
    }
    return {name: value for name, value in said.items() if value not in ("", [], None)}


FORMAT = Format(
    name="gltf",
    suffixes=(".glb",),
    write=write_gltf,
)
