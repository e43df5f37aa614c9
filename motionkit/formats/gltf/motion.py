"""glTF 2.0 binary (.glb): a skinned skeleton with one animation at the motion's own frames, for viewers and engines.

Nodes are joints, metres, y up. Rotations (and the root's translation) have a key at every frame; a body of octahedra
makes the skeleton visible. `asset.extras` holds what glTF has no place for: the exact framerate, captions, licence.
Source: Khronos, glTF 2.0 specification, §3.7.3 (skins) and §3.11 (animations).
"""

from pathlib import Path
from typing import Any

import numpy as np

from motionkit.formats.gltf.bone_mesh import BoneMesh, bone_meshes
from motionkit.formats.gltf.container import GlbBuffer
from motionkit.formats.joint_channels import JointChannels, joint_channels
from motionkit.kinematics import continuous_quaternions
from motionkit.motion import Motion
from motionkit.skeleton import Skeleton
from motionkit.skeletons.mapping import rest_positions
from motionkit.timegrid import TimeGrid, format_fps

COLOURS = {"left": (0.16, 0.42, 0.85, 1.0), "right": (0.90, 0.38, 0.12, 1.0), "middle": (0.55, 0.55, 0.58, 1.0)}
# (x, y, z, w)
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0], np.float32)


def write_gltf(motion: Motion, path: Path) -> None:
    """Write one motion as .glb; the first frame is at 0 s, keys are interpolated linearly (rotations by SLERP).

    A motion without rotations gets them by inverse kinematics, and translations where rigid bones would miss its
    positions (`joint_channels`). Key times are float32, as glTF wants them: exact to a thousandth of a frame for the
    first 16,000 frames, and to half a frame for 8 million.
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
    # At rest nothing is turned, so an inverse bind matrix only moves the joint to the origin; columns come first.
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
