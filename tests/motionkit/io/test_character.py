"""Motions on another skeleton, and on a character's own file: limbs point where the source's do, and the file stays."""

import json
import struct
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core import kinematics
from motionkit.fields.motion_field import to_motion
from motionkit.io.bvh import write_bvh
from motionkit.io.character import read_character
from motionkit.io.gltf import GlbBuffer
from motionkit.io.registry import ReadOptions
from motionkit.io.retargeting import retarget, stands
from motionkit.io.smpl_body import mean_shape_skeleton
from tests.helpers.analytic import analytic_motion
from tests.helpers.bones import mixamo_name
from tests.helpers.refusal import refusal
from tests.motionkit.io.test_gltf import Played

LIMBS = [("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")]


@pytest.fixture(scope="module")
def motion() -> mk.Motion:
    """Two seconds of arms and legs that turn about themselves too, on SMPL's mean shape."""
    rng, skeleton = np.random.default_rng(2), mean_shape_skeleton()
    angles = np.cumsum(rng.normal(0, 0.02, (60, 22, 3)), axis=0) + rng.normal(0, 0.3, (22, 3))
    rotations = kinematics.rotation_vector_to_quaternion(angles).astype(np.float32)
    root = np.array([0.3, 0.9, -1.0], np.float32) + np.linspace(0, 1, 60, dtype=np.float32)[:, None]
    places = kinematics.forward_kinematics(rotations, root, skeleton)
    return mk.Motion(places, skeleton, mk.TimeGrid(Fraction(30), 60), rotations, root, action="dance")


def directions(motion: mk.Motion) -> np.ndarray:
    """Of both sides' limbs, [T, 8, 3]."""
    index, places = motion.skeleton.index, motion.joint_positions
    bones = np.stack(
        [
            places[:, index(f"{side}_{below}")] - places[:, index(f"{side}_{above}")]
            for side in ("left", "right")
            for above, below in LIMBS
        ],
        axis=1,
    )
    return np.asarray(bones / np.linalg.norm(bones, axis=-1, keepdims=True))


def turned_at_rest(skeleton: mk.Skeleton, joint: str, vector: tuple[float, float, float]) -> mk.Skeleton:
    """The skeleton whose rest pose has a joint and what hangs on it turned: an A-pose, another facing."""
    turn = kinematics.rotation_vector_to_quaternion(np.array(vector))
    below = {skeleton.index(joint)}
    offsets = skeleton.offsets.astype(np.float64)
    for each, parent in enumerate(skeleton.parents):
        if parent in below:
            below.add(each)
            offsets[each] = kinematics.quaternion_rotate(turn, offsets[each])
    return replace(skeleton, offsets=offsets.astype(np.float32))


def test_onto_its_own_skeleton_nothing_changes(motion: mk.Motion) -> None:
    made = retarget(motion, motion.skeleton)
    assert made.local_rotations is not None and motion.local_rotations is not None
    np.testing.assert_allclose(made.joint_positions, motion.joint_positions, atol=2e-5)
    same = np.abs(np.sum(made.local_rotations * motion.local_rotations, axis=-1))
    assert same.min() > 1 - 1e-6
    assert made.action == "dance" and made.timegrid == motion.timegrid
    assert made.provenance.operations[-1] == "onto the skeleton smpl22-mean-shape: legs and path × 1.000"


@pytest.mark.parametrize(
    ("joint", "vector"),
    [
        ("left_shoulder", (0.0, 0.0, -0.8)),
        ("right_shoulder", (0.0, 0.0, 1.4)),
        ("left_hip", (0.0, 0.0, 0.3)),
        ("pelvis", (0.0, 2.5, 0.0)),
        ("pelvis", (0.0, np.pi, 0.0)),
    ],
)
def test_limbs_point_where_the_source_s_do_whatever_the_rest_pose(motion, joint, vector):
    rig = turned_at_rest(motion.skeleton, joint, vector)
    made = retarget(motion, rig)
    assert stands(rig)
    np.testing.assert_allclose(directions(made), directions(motion), atol=2e-5)
    bones = np.linalg.norm(made.joint_positions[:, 1:] - made.joint_positions[:, rig.parents[1:]], axis=-1)
    np.testing.assert_allclose(bones, np.linalg.norm(rig.offsets[1:], axis=-1)[None].repeat(60, 0), atol=2e-5)
    back = retarget(made, motion.skeleton)
    np.testing.assert_allclose(back.joint_positions, motion.joint_positions, atol=1e-4)


def test_a_root_on_the_floor_and_a_tail_come_along(motion: mk.Motion) -> None:
    body = motion.skeleton
    rig = mk.Skeleton(
        "with-reference",
        ("Reference", *body.joint_names, "tail"),
        (-1, *(parent + 1 for parent in body.parents), 1),
        np.concatenate((np.zeros((1, 3)), [[0.0, 0.95, 0.0]], body.offsets[1:], [[0.0, 0.0, -0.4]])).astype(np.float32),
    )
    made = retarget(motion, rig)
    np.testing.assert_allclose(made.joint_positions[:, 1:23], motion.joint_positions, atol=1e-3)
    tail = made.joint_positions[:, 23] - made.joint_positions[:, 1]
    np.testing.assert_allclose(np.linalg.norm(tail, axis=-1), 0.4, atol=1e-5)


def prefixed(joint: str) -> str:
    return f"mixamorig:{mixamo_name(joint)}"


@pytest.fixture(scope="module")
def walk() -> mk.Motion:
    """Two seconds of a walk at 60000/1001 fps."""
    return to_motion(analytic_motion("walk", 2.0), Fraction(60000, 1001))


@pytest.fixture(scope="module")
def rig() -> mk.Skeleton:
    """A small body with Mixamo's names."""
    body = mean_shape_skeleton().scaled(0.6)
    return replace(body, name="figure", joint_names=tuple(map(prefixed, body.joint_names)), feet=None)


def as_smpl(motion: mk.Motion) -> mk.Motion:
    """The motion with SMPL's names, in SMPL's order."""
    order = [motion.skeleton.joint_names.index(prefixed(name)) for name in mean_shape_skeleton().joint_names]
    return replace(
        motion,
        joint_positions=motion.joint_positions[:, order],
        skeleton=mean_shape_skeleton(),
        local_rotations=None,
        root_translation=None,
    )


def t_pose(rig: mk.Skeleton) -> mk.Motion:
    unturned = np.zeros((2, rig.num_joints, 4), np.float32)
    unturned[..., 0] = 1.0
    root = np.tile(np.array([0, 0.6, 0], np.float32), (2, 1))
    places = kinematics.forward_kinematics(unturned, root, rig)
    return mk.Motion(places, rig, mk.Motion.from_joints(places, 30, rig).timegrid, unturned, root)


def test_a_bvh_keeps_its_hierarchy_and_moves_as_the_source(walk: mk.Motion, rig: mk.Skeleton, tmp_path: Path) -> None:
    write_bvh(t_pose(rig), tmp_path / "figure.bvh", unit_metres=0.001)
    options = ReadOptions(unit_metres=0.001)
    character = read_character(tmp_path / "figure.bvh", options)
    character.write(character.perform(walk), tmp_path / "walk.bvh")
    heads = [(tmp_path / name).read_text().split("MOTION")[0] for name in ("figure.bvh", "walk.bvh")]
    assert heads[0] == heads[1]
    made = mk.read(tmp_path / "walk.bvh", unit_metres=0.001)
    assert (made.fps, made.num_frames) == (walk.fps, walk.num_frames)
    np.testing.assert_allclose(directions(as_smpl(made)), directions(walk), atol=1e-3)
    # Smaller legs go as much less far.
    hips = [motion.joint_positions[:, 0, [0, 2]] for motion in (made, walk)]
    ways = [np.linalg.norm(np.diff(places, axis=0), axis=-1).sum() for places in hips]
    legs = [np.linalg.norm(skeleton.offsets[[4, 7]], axis=-1).sum() for skeleton in (rig, walk.skeleton)]
    assert ways[0] / ways[1] == pytest.approx(legs[0] / legs[1], rel=0.02)
    assert float(np.quantile(made.joint_positions[..., 1].min(axis=1), 0.05)) == pytest.approx(
        legs[0] / legs[1] * float(np.quantile(walk.joint_positions[..., 1].min(axis=1), 0.05)), abs=0.02
    )


def write_glb_rig(path: Path, rig: mk.Skeleton) -> list[dict[str, object]]:
    """A skinned rig as Blender writes it: centimetres below an armature that lies down, every bone along its own y."""
    rng = np.random.default_rng(0)
    turns = kinematics.rotation_vector_to_quaternion(rng.normal(0, 1, (rig.num_joints, 3)))
    down = kinematics.rotation_vector_to_quaternion(np.array([-np.pi / 2, 0, 0]))
    nodes: list[dict[str, object]] = [
        {"name": "Armature", "scale": [0.01] * 3, "rotation": _xyzw(down), "children": [1]}
    ]
    for joint, parent in enumerate(rig.parents):
        above = turns[parent] if parent >= 0 else down
        back = kinematics.quaternion_conjugate(above)
        place = kinematics.quaternion_rotate(back, 100 * rig.offsets[joint].astype(np.float64))
        nodes.append(
            {
                "name": rig.joint_names[joint],
                "translation": place.tolist(),
                "rotation": _xyzw(kinematics.quaternion_multiply(back, turns[joint])),
                "children": [child + 1 for child in rig.children(joint)],
            }
        )
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    buffer = GlbBuffer()
    mesh = {"primitives": [{"attributes": {"POSITION": buffer.add(np.eye(3, dtype=np.float32), bounds=True)}}]}
    skin = {"joints": list(range(1, rig.num_joints + 1))}
    document = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, len(nodes) - 1]}]}
    buffer.write(path, {**document, "nodes": nodes, "meshes": [mesh], "skins": [skin]})
    return nodes


def _xyzw(q: np.ndarray) -> list[float]:
    return [*q[1:].tolist(), float(q[0])]


def read_glb(path: Path) -> tuple[dict[str, object], bytes]:
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def write_glb(path: Path, document: dict[str, object], binary: bytes) -> None:
    text = json.dumps(document).encode()
    head = struct.pack("<5I", 0x46546C67, 2, 28 + len(text) + len(binary), len(text), 0x4E4F534A)
    path.write_bytes(head + text + struct.pack("<2I", len(binary), 0x004E4942) + binary)


def world_places(path: Path) -> np.ndarray:
    """Where the nodes are in the world in every frame of a file's animation, by matrices."""
    file = Played(path)
    frames = [file.world(frame) for frame in range(len(file.seconds))]
    return np.array([[world[node][:3, 3] for node in sorted(world)] for world in frames])


def test_a_glb_keeps_its_nodes_and_moves_as_the_source(walk: mk.Motion, rig: mk.Skeleton, tmp_path: Path) -> None:
    nodes = write_glb_rig(tmp_path / "figure.glb", rig)
    character = read_character(tmp_path / "figure.glb", ReadOptions())
    performed = character.perform(walk)
    character.write(performed, tmp_path / "walk.glb")
    document, _ = read_glb(tmp_path / "walk.glb")
    assert document["nodes"] == nodes and len(document["meshes"]) == 1
    places = world_places(tmp_path / "walk.glb")[:, 1:23].astype(np.float32)
    own = [rig.joint_names.index(name) for name in performed.skeleton.joint_names]
    np.testing.assert_allclose(places[:, own], performed.joint_positions, atol=1e-4)
    np.testing.assert_allclose(mk.read(tmp_path / "walk.glb").joint_positions, places, atol=1e-5)
    moved = mk.Motion(places, rig, walk.timegrid)
    np.testing.assert_allclose(directions(as_smpl(moved)), directions(walk), atol=1e-3)
    lengths = np.linalg.norm(places[:, 1:] - places[:, list(rig.parents[1:])], axis=-1)
    np.testing.assert_allclose(
        lengths, np.linalg.norm(rig.offsets[1:], axis=-1)[None].repeat(len(places), 0), atol=1e-4
    )


@pytest.mark.parametrize(
    "damage",
    [
        lambda document: document.pop("skins"),
        lambda document: document["skins"][0].update(joints=[1, 999]),
        lambda document: document["nodes"][3].update(children=[1]),
        lambda document: document["nodes"][2].update(scale=[0, 1, 1]),
    ],
)
def test_a_glb_that_is_no_rig_is_refused(rig: mk.Skeleton, tmp_path: Path, damage: object) -> None:
    write_glb_rig(tmp_path / "whole.glb", rig)
    document, binary = read_glb(tmp_path / "whole.glb")
    damage(document)  # type: ignore[operator]
    write_glb(tmp_path / "bad.glb", document, binary)
    for content in ((tmp_path / "bad.glb").read_bytes(), b"glTF" + bytes(40)):
        (tmp_path / "bad.glb").write_bytes(content)
        assert refusal(read_character, tmp_path / "bad.glb", ReadOptions()).reason == "gltf"


def test_bones_that_rest_along_x_take_the_first_frame_s_pose(walk: mk.Motion, rig: mk.Skeleton, tmp_path: Path) -> None:
    pose = t_pose(rig)
    lengths = np.linalg.norm(rig.offsets, axis=-1)
    along = replace(rig, offsets=np.stack((lengths, 0 * lengths, 0 * lengths), axis=-1).astype(np.float32))
    single = [len(rig.children(joint)) == 1 for joint in range(22)]
    offsets = np.array(rig.offsets)
    for joint, parent in enumerate(rig.parents):
        if parent >= 0 and single[parent]:
            offsets[joint] = along.offsets[joint]
    along = replace(rig, offsets=offsets)
    rotations = kinematics.inverse_kinematics(pose.joint_positions, along)
    standing = replace(pose, skeleton=along, local_rotations=rotations)
    write_bvh(standing, tmp_path / "along.bvh")
    character = read_character(tmp_path / "along.bvh", ReadOptions())
    assert character.rest is not None
    character.write(character.perform(walk), tmp_path / "walk.bvh")
    made = mk.read(tmp_path / "walk.bvh")
    np.testing.assert_allclose(directions(as_smpl(made)), directions(walk), atol=1e-3)
