"""glTF 2.0 binary (.glb): motions as a skinned skeleton with one animation, read back; and onto a character's rig.

Nodes are joints, metres, y up. Rotations (and the root's translation) are written with a key at every frame; octahedra
make the bones visible. `asset.extras` holds what glTF has no field for: the exact framerate, captions, licence.
Source: Khronos, glTF 2.0 specification, §3.5 (nodes), §3.7 (meshes and skins), §3.11 (animations), §4.4 (GLB).
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.files import parse_json, read_at_most
from motionkit.core.motion import Caption, Motion
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import MAX_JOINTS, SMPL22, Skeleton
from motionkit.core.skeletons.mapping import (
    SkeletonMapError,
    counterpart_joints,
    rest_positions,
    rig_name,
    with_layout_map,
)
from motionkit.core.timegrid import TimeGrid, num_frames_within, parse_fps
from motionkit.io import source_file
from motionkit.io.body_frame import in_metres
from motionkit.io.joint_rotations import RIGID_METRES, joint_channels
from motionkit.io.registry import ReadOptions
from motionkit.io.source_file import unique_names

MAGIC, VERSION = 0x46546C67, 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
COMPONENT_TYPES = {"float32": 5126, "uint16": 5123, "uint32": 5125}
WIDTHS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
# Of animated values; whole numbers are shares of the largest one.
DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
# glTF's key times are float32: a step's value holds from this much before its key.
KEY_SECONDS = 1e-4
LARGEST_BYTES = 1 << 30
# A bone is thickest at a sixth of its length, with the thickness of Blender's bones.
WAIST, THICKNESS = 1 / 6, 0.1
JOINT_RADIUS_METRES, SHORTEST_METRES = 0.015, 1e-3
# Corners of an octahedron: start, four around the waist, tip. Faces are counter-clockwise seen from outside.
FACES = np.array([(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 1, 4), (5, 1, 2), (5, 2, 3), (5, 3, 4), (5, 4, 1)])
# By side: -1 left, 0 neither, 1 right.
COLOURS = {
    -1: ("left", (0.16, 0.42, 0.85, 1.0)),
    1: ("right", (0.90, 0.38, 0.12, 1.0)),
    0: ("middle", (0.55, 0.55, 0.58, 1.0)),
}
# (x, y, z, w)
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0], np.float32)

Channels = list[tuple[int, str, Float32[np.ndarray, "_ _"]]]
"""Animated values: the node, "translation" or "rotation" (x, y, z, w), a key at every frame."""


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

    def add(self, array: np.ndarray, *, bounds: bool = False) -> int:
        """Append float32, uint16 or uint32 values, one element per row; returns the accessor's index.

        `bounds` adds minimum and maximum (required for positions and key times).
        """
        rows = np.ascontiguousarray(array.reshape(len(array), -1))
        view = {"buffer": 0, "byteOffset": len(self._content), "byteLength": rows.nbytes}
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

    def animation(self, motion: Motion, channels: Channels) -> dict[str, Any]:
        """An animation with the first frame at 0 s, interpolated linearly (rotations by SLERP)."""
        seconds = np.arange(motion.num_frames) / float(motion.fps)
        keys = self.add(seconds.astype(np.float32), bounds=True)
        return {
            "name": motion.sequence_id or "motion",
            "samplers": [{"input": keys, "output": self.add(values)} for _, _, values in channels],
            "channels": [
                {"sampler": number, "target": {"node": node, "path": path}}
                for number, (node, path, _) in enumerate(channels)
            ],
        }

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


def write_gltf(motion: Motion, path: Path) -> None:
    """Write one motion as .glb, the first frame at 0 s.

    A motion without rotations gets them by inverse kinematics, and translations if rigid bones would miss its positions
    (`joint_channels`). Key times are float32, as glTF requires: exact to a thousandth of a frame for the first 16,000
    frames, and to half a frame for 8 million.
    """
    joints = joint_channels(motion)
    skeleton, buffer = joints.skeleton, GlbBuffer()
    rotations = kinematics.continuous_quaternions(joints.rotations.astype(np.float64))
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    turns = rotations[..., [1, 2, 3, 0]].astype(np.float32)
    channels: Channels = [(joint, "translation", places) for joint, places in joints.translations.items()]
    channels += [
        (joint, "rotation", turns[:, joint])
        for joint in range(skeleton.num_joints)
        if not (turns[:, joint] == IDENTITY).all()
    ]
    nodes: list[dict[str, Any]] = []
    for joint, name in enumerate(skeleton.joint_names):
        children = {"children": list(skeleton.children(joint))} if skeleton.children(joint) else {}
        nodes.append({"name": name, "translation": skeleton.offsets[joint].tolist(), **children})
    # Rest rotations are identities, so an inverse bind matrix is a translation to the origin; in column-major order.
    inverse = np.tile(np.eye(4, dtype=np.float32), (skeleton.num_joints, 1, 1))
    inverse[:, 3, :3] = -rest_positions(skeleton)
    primitives, materials = _body(skeleton, buffer)
    document = {
        "asset": {"version": "2.0", "generator": "motionkit", "extras": _extras(motion)},
        "scene": 0,
        "scenes": [{"nodes": [0, skeleton.num_joints]}],
        "nodes": [*nodes, {"name": "body", "mesh": 0, "skin": 0}],
        "meshes": [{"name": "body", "primitives": primitives}],
        "materials": materials,
        "skins": [{"joints": list(range(len(nodes))), "skeleton": 0, "inverseBindMatrices": buffer.add(inverse)}],
        "animations": [buffer.animation(motion, channels)],
    }
    buffer.write(path, document)


def joint_sides(skeleton: Skeleton) -> tuple[int, ...]:
    """The side of each joint, -1 left, 0 neither, 1 right, by its pairs and its map to the 22; children inherit it."""
    sides = [0] * skeleton.num_joints
    for left, right in skeleton.left_right_pairs:
        sides[left], sides[right] = -1, 1
    try:
        counterparts = counterpart_joints(skeleton)
    except SkeletonMapError:
        counterparts = {}
    for joint, source in counterparts.items():
        side = SMPL22.joint_names[joint].partition("_")[0]
        sides[source] = sides[source] or {"left": -1, "right": 1}.get(side, 0)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            sides[joint] = sides[joint] or sides[parent]
    return tuple(sides)


def _body(skeleton: Skeleton, buffer: GlbBuffer) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """A mesh of the rest pose: primitives and materials, one for each side that has joints; viewers compute normals.

    A joint is a small octahedron, a bone a long one. A bone's tip is bound to its end joint, its other corners to its
    start joint, so that tips stay at their joints if bones change length.
    """
    rest, sides = rest_positions(skeleton).astype(np.float64), joint_sides(skeleton)
    up = np.array([0.0, JOINT_RADIUS_METRES, 0.0])
    corners = [_octahedron(place - up, place + up, 0.5, JOINT_RADIUS_METRES) for place in rest]
    bound = [(joint,) * 6 for joint in range(skeleton.num_joints)]
    bones = [(parent, joint, rest[joint]) for joint, parent in enumerate(skeleton.parents) if parent >= 0]
    bones += [(joint, joint, rest[joint] + np.array(tip)) for joint, tip in skeleton.end_sites]
    for start, end, tip in bones:
        length = float(np.linalg.norm(tip - rest[start]))
        if length > SHORTEST_METRES:
            corners.append(_octahedron(rest[start], tip, WAIST, THICKNESS * length))
            bound.append((*(start,) * 5, end))
    joints = np.zeros((6 * len(corners), 4), np.uint16)
    joints[:, 0] = np.ravel(bound)
    weights = np.zeros((len(joints), 4), np.float32)
    weights[:, 0] = 1.0
    attributes = {
        "POSITION": buffer.add(np.concatenate(corners).astype(np.float32), bounds=True),
        "JOINTS_0": buffer.add(joints),
        "WEIGHTS_0": buffer.add(weights),
    }
    primitives: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    for side, (name, colour) in COLOURS.items():
        solids = [number for number, ends in enumerate(bound) if sides[ends[-1]] == side]
        if solids:
            faces = (6 * np.array(solids)[:, None, None] + FACES).astype(np.uint32)
            indices = buffer.add(faces.ravel())
            primitives.append({"attributes": attributes, "indices": indices, "material": len(materials)})
            surface = {"baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 0.8}
            materials.append({"name": name, "pbrMetallicRoughness": surface})
    return primitives, materials


def _octahedron(
    start: Float64[np.ndarray, "3"], tip: Float64[np.ndarray, "3"], waist: float, radius: float
) -> Float64[np.ndarray, "6 3"]:
    along = (tip - start) / np.linalg.norm(tip - start)
    # Any axis that is not nearly parallel.
    first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    first /= np.linalg.norm(first)
    second = np.cross(along, first)
    ring = start + waist * (tip - start) + radius * np.stack((first, second, -first, -second))
    return np.concatenate((start[None], ring, tip[None]))


def _extras(motion: Motion) -> dict[str, Any]:
    provenance = motion.provenance
    extras = {
        "sequence_id": motion.sequence_id,
        "fps": str(motion.fps),
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
    return {name: value for name, value in extras.items() if value not in ("", [], None)}


@dataclass(frozen=True, eq=False)
class GltfRig:
    """A character's .glb: unchanged `document` and `binary`, the node of each joint, rotations of the rest pose.

    `rest` are the world rotations of the joints' nodes, `above` those of the nodes directly above them; `carrier`
    (4 × 4) is the transform of the node above the root. The skeleton's rest pose has identity rotations.
    """

    document: dict[str, Any]
    binary: bytes
    skeleton: Skeleton
    nodes: tuple[int, ...]
    rest: Float64[np.ndarray, "joints 4"]
    above: Float64[np.ndarray, "joints 4"]
    carrier: Float64[np.ndarray, "4 4"]

    def write(self, motion: Motion, path: Path) -> None:
        """The same file with this motion of its skeleton in place of its animations, the first frame at 0 s."""
        assert motion.local_rotations is not None and motion.root_translation is not None
        turns = kinematics.quaternion_multiply(motion.local_rotations.astype(np.float64), self.rest)
        turns = kinematics.quaternion_multiply(kinematics.quaternion_conjugate(self.above), turns)
        turns = kinematics.continuous_quaternions(turns)[..., [1, 2, 3, 0]].astype(np.float32)
        places = motion.root_translation.astype(np.float64) - self.carrier[:3, 3]
        places = (places @ np.linalg.inv(self.carrier[:3, :3]).T).astype(np.float32)
        channels: Channels = [(self.nodes[0], "translation", places)]
        channels += [(node, "rotation", turns[:, joint]) for joint, node in enumerate(self.nodes)]
        buffer = GlbBuffer(self.binary, self.document.get("bufferViews", []), self.document.get("accessors", []))
        nodes = [
            _without_matrix(node) if number in self.nodes else node
            for number, node in enumerate(self.document["nodes"])
        ]
        buffer.write(path, {**self.document, "nodes": nodes, "animations": [buffer.animation(motion, channels)]})


def read_rig(path: Path, options: ReadOptions) -> GltfRig:
    """The rig of a .glb; raises `FormatError` (`gltf`) for any other file, or one without a skin with a single root."""
    try:
        return _rig(*_read_chunks(read_at_most(path, LARGEST_BYTES)), options)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, struct.error) as error:
        raise FormatError(f"no .glb with a skinned skeleton ({error!r})", path=path, reason="gltf") from None


def _read_chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    magic, version, _, size, kind = struct.unpack_from("<5I", data)
    if magic != MAGIC or version != VERSION or kind != JSON_CHUNK:
        raise ValueError("not glTF 2.0, binary")
    document: dict[str, Any] = parse_json(data[20 : 20 + size].decode())
    start = 20 + size
    if start >= len(data):
        return document, b""
    size, kind = struct.unpack_from("<2I", data, start)
    if kind != BINARY_CHUNK:
        raise ValueError("its second chunk is no binary one")
    return document, data[start + 8 : start + 8 + size]


def _joints(document: dict[str, Any]) -> tuple[list[int], list[int], dict[int, list[int]]]:
    """The nodes that are joints, parents first, each one's parent among them, and of each the nodes above it.

    They are those of the skins; without a skin the animated nodes and all below them. Raises `ValueError` unless they
    have a single root. The nearest node above comes first.
    """
    nodes: list[dict[str, Any]] = document["nodes"]
    parent_of = {child: number for number, node in enumerate(nodes) for child in node.get("children", ())}
    joints = {joint for skin in document.get("skins", ()) for joint in skin["joints"]}
    if not joints and document.get("animations"):
        moved = {each["target"].get("node", -1) for each in document["animations"][0]["channels"]}
        joints = {node for node in range(len(nodes)) if moved & {node, *_nodes_above(node, parent_of)}}
    if not 1 <= len(joints) <= MAX_JOINTS or not all(0 <= joint < len(nodes) for joint in joints):
        raise ValueError(f"{len(joints)} joints")
    chains = {joint: _nodes_above(joint, parent_of) for joint in joints}
    order = sorted(joints)
    if any(node > joint for joint in joints for node in joints.intersection(chains[joint])):
        order.sort(key=lambda joint: len(chains[joint]))
    number_of = {joint: number for number, joint in enumerate(order)}
    parents = [next((number_of[node] for node in chains[joint] if node in joints), -1) for joint in order]
    if parents.count(-1) != 1:
        raise ValueError(f"{parents.count(-1)} roots, expected 1")
    return order, parents, chains


def _rig(document: dict[str, Any], binary: bytes, options: ReadOptions) -> GltfRig:
    if not document["skins"]:
        raise ValueError("no skin")
    order, parents, chains = _joints(document)
    world = _world(document["nodes"], order, chains, {})
    matrices = np.concatenate([world[joint] for joint in order])
    above = np.concatenate([world[next(iter(chains[joint]), -1)] for joint in order])
    rest, rest_above = _rotations(matrices), _rotations(above)
    if (np.linalg.det(rest) < 0).any():
        raise ValueError("a node that mirrors")
    return GltfRig(
        document,
        binary,
        _skeleton(document["nodes"], order, parents, matrices, options),
        tuple(order),
        kinematics.matrix_to_quaternion(rest),
        kinematics.matrix_to_quaternion(rest_above),
        above[0],
    )


def _skeleton(
    nodes: list[dict[str, Any]],
    order: list[int],
    parents: list[int],
    rest: Float64[np.ndarray, "joints 4 4"],
    options: ReadOptions,
) -> Skeleton:
    """The skeleton of joints with these transforms at rest, whose rotations are identities there."""
    names = unique_names([str(nodes[joint].get("name", f"node {joint}")) for joint in order])[0]
    places = rest[:, :3, 3]
    offsets = places - np.where(np.array(parents)[:, None] < 0, 0.0, places[np.maximum(parents, 0)])
    skeleton = Skeleton(rig_name(names), names, tuple(parents), offsets.astype(np.float32))
    return with_layout_map(skeleton, options.skeleton_maps)


def read_gltf(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read the first animation of a .glb: positions in metres, y up, rotations relative to the rest pose of its nodes.

    Joints are those of the skin, without one the animated nodes and all below. The framerate is that of the most keys,
    which must be even in time; with `options.fps` the animation, a function of time, is sampled at it. Bones that
    change by more than 2 mm leave positions alone. Raises `FormatError` (`gltf`, `no-framerate`, `frame-time`).
    """
    data = source_file.read_bytes(path)
    try:
        document, binary = _read_chunks(data)
        return in_metres(_motion(document, binary, data, path, options), options.unit_metres)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, struct.error) as error:
        message = f"no .glb with an animated skeleton ({error or error!r})"
        raise FormatError(message, path=path, reason="gltf") from None


def _motion(document: dict[str, Any], binary: bytes, data: bytes, path: Path, options: ReadOptions) -> Motion:
    nodes, extras = document["nodes"], document["asset"].get("extras") or {}
    if not (animations := document.get("animations")):
        raise ValueError("it has no animation")
    if len(animations) > 1:
        warn(f"{path}: the first of {len(animations)} animations is read")
    order, parents, chains = _joints(document)
    tracks = []
    for channel in animations[0]["channels"]:
        sampler, target = animations[0]["samplers"][channel["sampler"]], channel["target"]
        if "node" in target and target["path"] in ("translation", "rotation", "scale"):
            keys, values = (_numbers(document, binary, sampler[name]) for name in ("input", "output"))
            track = (keys[:, 0], values, str(sampler.get("interpolation", "LINEAR")))
            tracks.append((target["node"], target["path"], track))
    keys = max((track[0] for _, _, track in tracks), key=len)
    if options.fps is None:
        grid = source_file.grid_of_seconds(keys, path, parse_fps(extras["fps"]) if "fps" in extras else None)
    else:
        grid = TimeGrid(options.fps, num_frames_within(float(keys[-1] - keys[0]), options.fps), float(keys[0]))
    source_file.check_size(grid.num_frames, len(order), path)
    seconds = grid.seconds()
    moved = {(node, name): _sampled(*track, seconds, is_rotation=name == "rotation") for node, name, track in tracks}
    world, rest = (_world(nodes, order, chains, each) for each in (moved, {}))
    num_frames = max(map(len, world.values()))
    matrices = np.stack([np.broadcast_to(world[joint], (num_frames, 4, 4)) for joint in order], axis=1)
    rest_matrices = np.concatenate([rest[joint] for joint in order])
    # A joint's turn is from its rest pose, in which all of them are thus identities.
    turns = _rotations(matrices) @ _rotations(rest_matrices).swapaxes(-1, -2)
    skeleton = _skeleton(nodes, order, parents, rest_matrices, options)
    positions = matrices[..., :3, 3].astype(np.float32)
    local = np.concatenate((turns[:, :1], turns[:, parents[1:]].swapaxes(-1, -2) @ turns[:, 1:]), axis=1)
    rotations = kinematics.matrix_to_quaternion(local).astype(np.float32)
    reached = kinematics.forward_kinematics(rotations, positions[:, 0], skeleton)
    is_rigid = np.abs(reached - positions).max() <= RIGID_METRES
    captions = (
        Caption(each["text"], each["start_seconds"], each["end_seconds"]) for each in extras.get("captions", ())
    )
    log = [] if is_rigid else ["positions only: bones change their lengths"]
    if options.fps is not None:
        log.append(f"sampled at {options.fps} fps")
    origin = source_file.provenance(path, data, "gltf", log, stated_fps=str(extras.get("fps", "")))
    return Motion(
        positions,
        skeleton,
        replace(grid, start_seconds=grid.start_seconds + float(extras.get("start_seconds", 0.0))),
        local_rotations=rotations if is_rigid else None,
        root_translation=positions[:, 0] if is_rigid else None,
        captions=tuple(captions),
        action=str(extras.get("action", "")),
        style=str(extras.get("style", "")),
        sequence_id=path.stem,
        provenance=replace(origin, source=str(extras.get("source", "")), licence=str(extras.get("licence", ""))),
    )


def _numbers(document: dict[str, Any], binary: bytes, index: int) -> Float64[np.ndarray, "rows width"]:
    """The values of an accessor; raises `ValueError` for sparse ones and those of other files."""
    accessor = document["accessors"][index]
    view, dtype = document["bufferViews"][accessor["bufferView"]], np.dtype(DTYPES[accessor["componentType"]])
    width = next(number for number, name in WIDTHS.items() if name == accessor["type"])
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride, count = view.get("byteStride", width * dtype.itemsize), accessor["count"]
    if "sparse" in accessor or "uri" in document["buffers"][view["buffer"]] or view["buffer"] != 0:
        raise ValueError("its animation is sparse or in another file: export one .glb")
    values = np.ndarray((count, width), dtype, binary, start, (stride, dtype.itemsize)).astype(np.float64)
    if not np.isfinite(values).all():
        raise ValueError(f"accessor {index} holds what is no number")
    return values if dtype.kind == "f" else np.maximum(values / np.iinfo(dtype).max, -1.0)


def _sampled(
    keys: Float64[np.ndarray, "keys"],
    values: Float64[np.ndarray, "rows width"],
    interpolation: str,
    seconds: Float64[np.ndarray, "frames"],
    *,
    is_rotation: bool,
) -> Float64[np.ndarray, "frames width"]:
    """An animated value at some instants, before the first key and after the last as at them (glTF, appendix C)."""
    last = len(keys) - 1
    if (np.diff(keys) <= 0).any():
        raise ValueError("key times do not ascend")
    start = np.clip(np.searchsorted(keys, seconds + KEY_SECONDS, side="right") - 1, 0, last)
    if interpolation == "STEP":
        return values[start]
    end = np.minimum(start + 1, last)
    step = np.where(end > start, keys[end] - keys[start], 1.0)
    share = np.clip((seconds - keys[start]) / step, 0.0, 1.0)
    t = share[:, None]
    if interpolation == "CUBICSPLINE":
        arriving, at, leaving = values.reshape(last + 1, 3, -1).swapaxes(0, 1)
        bend = (t - 1) * leaving[start] + t * arriving[end]
        sampled = (
            (1 + 2 * t) * (1 - t) ** 2 * at[start] + t**2 * (3 - 2 * t) * at[end] + t * (t - 1) * step[:, None] * bend
        )
    elif is_rotation:
        if not np.square(values).sum(axis=1).min() > 0.0:
            raise ValueError("a rotation of length 0")
        sampled = kinematics.quaternion_slerp(values[start], values[end], share)
    else:
        sampled = (1 - t) * values[start] + t * values[end]
    return np.asarray(sampled)


def _world(
    nodes: list[dict[str, Any]],
    order: list[int],
    chains: dict[int, list[int]],
    moved: Mapping[tuple[int, str], Float64[np.ndarray, "frames _"]],
) -> dict[int, Float64[np.ndarray, "_ 4 4"]]:
    """Transforms in the world of joints and of the nodes above them, with the animated values in place of their own.

    That of -1 is the identity.
    """
    world: dict[int, np.ndarray] = {-1: np.eye(4)[None]}
    for joint in order:
        for node, above in zip(path := [*reversed(chains[joint]), joint], [-1, *path[:-1]], strict=True):
            if node not in world:
                own = {name: values for (each, name), values in moved.items() if each == node}
                world[node] = world[above] @ _matrices({**_without_matrix(nodes[node]), **own})
    return world


def _nodes_above(node: int, parent_of: dict[int, int]) -> list[int]:
    chain: list[int] = []
    while node in parent_of:
        node = parent_of[node]
        chain.append(node)
        if len(chain) > MAX_JOINTS:
            raise ValueError("nodes that are their own parents")
    return chain


def _matrices(node: dict[str, Any]) -> Float64[np.ndarray, "frames 4 4"]:
    """The local transform of a node, one for each frame of its animated values; without these a single one."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(1, 4, 4).swapaxes(1, 2)
    rest = {"rotation": (0, 0, 0, 1), "scale": (1, 1, 1), "translation": (0, 0, 0)}
    rotation, scale, place = (np.atleast_2d(np.array(node.get(name, own), np.float64)) for name, own in rest.items())
    lengths = np.linalg.norm(rotation, axis=-1, keepdims=True)
    if not lengths.min() > 0.0:
        raise ValueError("a rotation of length 0")
    rotation = rotation / lengths
    matrices = np.zeros((max(map(len, (rotation, scale, place))), 4, 4))
    matrices[:, :3, :3] = kinematics.quaternion_to_matrix(rotation[:, [3, 0, 1, 2]]) * scale[:, None]
    matrices[:, :3, 3], matrices[:, 3, 3] = place, 1.0
    return matrices


def _without_matrix(node: dict[str, Any]) -> dict[str, Any]:
    """A node with translation, rotation and scale in place of a matrix, as animated nodes require (§3.5.3)."""
    if "matrix" not in node:
        return node
    matrix = _matrices(node)[0]
    w, *xyz = kinematics.matrix_to_quaternion(_rotations(matrix)[None])[0].tolist()
    return {
        **{key: value for key, value in node.items() if key != "matrix"},
        "translation": matrix[:3, 3].tolist(),
        "rotation": [*xyz, w],
        "scale": np.linalg.norm(matrix[:3, :3], axis=0).tolist(),
    }


def _rotations(matrices: Float64[np.ndarray, "*n 4 4"]) -> Float64[np.ndarray, "*n 3 3"]:
    """The rotations of transforms, without their scale."""
    sizes = np.linalg.norm(matrices[..., :3, :3], axis=-2, keepdims=True)
    if not sizes.min() > 1e-9 * sizes.max():
        raise ValueError("a node that flattens")
    return np.asarray(matrices[..., :3, :3] / sizes)
