"""A rig in a .glb file: its skin's joints as a skeleton; the same file with another animation.

Source: Khronos, glTF 2.0 specification, §3.5 (nodes), §3.7.3 (skins), §4.4 (GLB).
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.files import read_at_most
from motionkit.core.motion import Motion
from motionkit.core.plain_text import parse_json
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import MAX_JOINTS, Skeleton
from motionkit.core.skeletons.families import with_layout_map
from motionkit.io.gltf import BINARY_CHUNK, JSON_CHUNK, MAGIC, GlbBuffer
from motionkit.io.registry import ReadOptions

LARGEST_BYTES = 1 << 30
REASON = "gltf"


@dataclass(frozen=True, eq=False)
class GltfRig:
    """A .glb: unchanged `document` and `binary`, the node of each joint of the skeleton, its rotations at rest.

    `carrier` (4 × 4) is the transform of the root's parent nodes; `above` of a joint is the rotation of the nodes
    between it and its parent joint.
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
        back = kinematics.quaternion_conjugate(self.above)
        turned = kinematics.quaternion_multiply(back[None], motion.local_rotations.astype(np.float64))
        turned = kinematics.continuous_quaternions(turned)[..., [1, 2, 3, 0]].astype(np.float32)
        place = motion.root_translation.astype(np.float64) - self.carrier[:3, 3]
        moved = (place @ np.linalg.inv(self.carrier[:3, :3]).T).astype(np.float32)
        buffer = GlbBuffer(self.binary, self.document.get("bufferViews", []), self.document.get("accessors", []))
        keys = buffer.add((np.arange(motion.num_frames) / float(motion.fps)).astype(np.float32), bounds=True)
        values = [(self.nodes[0], "translation", moved)]
        values += [(node, "rotation", turned[:, joint]) for joint, node in enumerate(self.nodes)]
        animation = {
            "name": motion.sequence_id or "motion",
            "samplers": [{"input": keys, "output": buffer.add(value)} for _, _, value in values],
            "channels": [
                {"sampler": number, "target": {"node": node, "path": kind}}
                for number, (node, kind, _) in enumerate(values)
            ],
        }
        nodes = [
            _in_parts(node) if number in self.nodes else node for number, node in enumerate(self.document["nodes"])
        ]
        buffer.write(path, {**self.document, "nodes": nodes, "animations": [animation]})


def read_rig(path: Path, options: ReadOptions) -> GltfRig:
    """The rig of a .glb; raises `FormatError` (`gltf`) for any other file, or one without a skin with a single root."""
    data = read_at_most(path, LARGEST_BYTES)
    try:
        document, binary = _chunks(data)
        return _rig(document, binary, path, options)
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, struct.error) as error:
        raise FormatError(f"no .glb with a skinned skeleton ({error!r})", path=path, reason=REASON) from None


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    magic, version, _, size, kind = struct.unpack_from("<5I", data)
    if magic != MAGIC or version != 2 or kind != JSON_CHUNK:
        raise ValueError("not glTF 2.0, binary")
    document: dict[str, Any] = parse_json(data[20 : 20 + size].decode())
    start = 20 + size
    if start >= len(data):
        return document, b""
    size, kind = struct.unpack_from("<2I", data, start)
    if kind != BINARY_CHUNK:
        raise ValueError("its second chunk is no binary one")
    return document, data[start + 8 : start + 8 + size]


def _rig(document: dict[str, Any], binary: bytes, path: Path, options: ReadOptions) -> GltfRig:
    nodes: list[dict[str, Any]] = document["nodes"]
    parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", ())}
    joints = {joint for skin in document["skins"] for joint in skin["joints"]}
    if not 1 <= len(joints) <= MAX_JOINTS or not all(0 <= joint < len(nodes) for joint in joints):
        raise ValueError(f"{len(joints)} joints")
    chains = {joint: _chain(joint, parents) for joint in joints}
    roots = [joint for joint in joints if not joints & set(chains[joint][1:])]
    if len(roots) != 1:
        raise ValueError(f"{len(roots)} roots, expected 1")
    order = sorted(joints, key=lambda joint: (len(chains[joint]), joint))
    matrices = [_matrix(node) for node in nodes]
    world = {joint: _product([matrices[each] for each in reversed(chains[joint])]) for joint in joints}
    places = np.array([world[joint][:3, 3] for joint in order])
    turns = kinematics.matrix_to_quaternion(np.array([_turn(world[joint]) for joint in order]))
    nearest = [next((order.index(each) for each in chains[joint][1:] if each in joints), -1) for joint in order]
    between = [chains[joint][1 : _stop(chains[joint], joints)] for joint in order]
    above = [_turn(_product([matrices[each] for each in reversed(chain)])) for chain in between]
    carrier = _product([matrices[each] for each in reversed(chains[order[0]][1:])])
    # Relative to the parent joint, across any nodes in between: `above` converts it to the node's own parent.
    rest = turns.copy()
    own = np.zeros_like(places)
    own[0] = places[0]
    for joint, parent in enumerate(nearest):
        if parent >= 0:
            back = kinematics.quaternion_conjugate(turns[parent])
            rest[joint] = kinematics.quaternion_multiply(back, turns[joint])
            own[joint] = kinematics.quaternion_rotate(back, places[joint] - places[parent])
    names = _distinct([str(nodes[joint].get("name", f"node {joint}")) for joint in order])
    skeleton = Skeleton(path.stem, names, tuple(nearest), own.astype(np.float32))
    skeleton = with_layout_map(skeleton, options.skeleton_maps)
    turned = kinematics.matrix_to_quaternion(np.array(above))
    return GltfRig(document, binary, skeleton, tuple(order), rest, turned, carrier)


def _chain(node: int, parents: dict[int, int]) -> list[int]:
    chain = [node]
    while chain[-1] in parents:
        chain.append(parents[chain[-1]])
        if len(chain) > MAX_JOINTS:
            raise ValueError("nodes that are their own parents")
    return chain


def _stop(chain: list[int], joints: set[int]) -> int:
    return next((place for place, each in enumerate(chain) if place and each in joints), len(chain))


def _matrix(node: dict[str, Any]) -> Float64[np.ndarray, "4 4"]:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = (float(each) for each in node.get("rotation", (0, 0, 0, 1)))
    made = np.eye(4)
    made[:3, :3] = kinematics.quaternion_to_matrix(np.array([w, x, y, z])) * np.array(node.get("scale", (1, 1, 1)))
    made[:3, 3] = node.get("translation", (0, 0, 0))
    return made


def _in_parts(node: dict[str, Any]) -> dict[str, Any]:
    """A node with translation, rotation and scale in place of a matrix, as animated nodes require (§3.5.3)."""
    if "matrix" not in node:
        return node
    matrix = _matrix(node)
    w, *xyz = kinematics.matrix_to_quaternion(_turn(matrix)[None])[0].tolist()
    parts = {"translation": matrix[:3, 3].tolist(), "rotation": [*xyz, w]}
    scale = np.linalg.norm(matrix[:3, :3], axis=0).tolist()
    return {key: value for key, value in node.items() if key != "matrix"} | parts | {"scale": scale}


def _product(matrices: list[Float64[np.ndarray, "4 4"]]) -> Float64[np.ndarray, "4 4"]:
    return np.asarray(np.linalg.multi_dot([np.eye(4), np.eye(4), *matrices]))


def _turn(matrix: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "3 3"]:
    """The rotation of a matrix, without its scale."""
    u, sizes, vt = np.linalg.svd(matrix[:3, :3])
    if sizes[-1] < 1e-9 * sizes[0] or np.linalg.det(u @ vt) < 0:
        raise ValueError("a node that flattens or mirrors")
    return np.asarray(u @ vt)


def _distinct(names: list[str]) -> tuple[str, ...]:
    seen: dict[str, int] = {}
    for name in names:
        seen[name] = seen.get(name, 0) + 1
    return tuple(name if seen[name] == 1 else f"{name}#{place}" for place, name in enumerate(names))
