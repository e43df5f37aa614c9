"""glTF: read by pygltflib, moved by a plain forward kinematics of the file's own numbers; and read by motionkit."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.kinematics import forward_kinematics
from motionkit.io.gltf import GlbBuffer, read_gltf, write_gltf
from motionkit.io.registry import ReadOptions
from tests.helpers.refusal import refusal

pygltflib = pytest.importorskip("pygltflib")

NUM_COMPONENTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
DTYPES = {5126: "<f4", 5123: "<u2", 5125: "<u4"}
STATIC = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


class Played:
    """A .glb as a viewer sees it."""

    def __init__(self, path):
        self.file = pygltflib.GLTF2().load(str(path))
        self.blob = self.file.binary_blob()
        animation = self.file.animations[0]
        self.channels = {}
        for channel in animation.channels:
            sampler = animation.samplers[channel.sampler]
            self.seconds = self.read(sampler.input)
            self.channels[channel.target.node, channel.target.path] = self.read(sampler.output)

    def read(self, index):
        accessor = self.file.accessors[index]
        view = self.file.bufferViews[accessor.bufferView]
        width = NUM_COMPONENTS[accessor.type]
        dtype = DTYPES[accessor.componentType]
        start = view.byteOffset + (accessor.byteOffset or 0)
        return np.frombuffer(self.blob, dtype, accessor.count * width, start).reshape(accessor.count, width)

    def local(self, node, frame):
        def value(path):
            if (node, path) in self.channels:
                return self.channels[node, path][frame].astype(float)
            return np.array(getattr(self.file.nodes[node], path) or STATIC[path], float)

        x, y, z, w = value("rotation")
        matrix = np.eye(4)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        matrix[:3, :3] *= value("scale")
        matrix[:3, 3] = value("translation")
        return matrix

    def world(self, frame):
        """World matrices of all nodes of the scene, by walking down from its roots."""
        found = {}
        waiting = [(node, np.eye(4)) for node in self.file.scenes[self.file.scene].nodes]
        while waiting:
            node, above = waiting.pop()
            found[node] = above @ self.local(node, frame)
            waiting += [(child, found[node]) for child in self.file.nodes[node].children or []]
        return found

    def vertices(self, frame):
        """Skinned positions and the joint each vertex is bound to."""
        skin = self.file.skins[0]
        world = self.world(frame)
        inverse = self.read(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1).astype(float)
        matrices = np.stack([world[joint] @ inverse[i] for i, joint in enumerate(skin.joints)])
        places, bound = [], []
        for primitive in self.file.meshes[0].primitives:
            attributes, used = primitive.attributes, self.read(primitive.indices).ravel()
            rest = np.c_[self.read(attributes.POSITION), np.ones(self.file.accessors[attributes.POSITION].count)]
            joints, weights = self.read(attributes.JOINTS_0), self.read(attributes.WEIGHTS_0)
            np.testing.assert_array_equal(weights.sum(axis=1), 1)
            moved = np.einsum("vk,vkij,vj->vi", weights, matrices[joints], rest)
            places.append(moved[used, :3])
            bound.append(joints[used, 0])
        return np.concatenate(places), np.concatenate(bound)


def turning(skeleton=mk.SMPL22, num_frames=12, fps=Fraction(60000, 1001)):
    rng = np.random.default_rng(0)
    rotations = rng.normal(size=(num_frames, skeleton.num_joints, 4)).astype(np.float32)
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    root = rng.normal(size=(num_frames, 3)).astype(np.float32)
    return mk.Motion(
        forward_kinematics(rotations, root, skeleton),
        skeleton,
        mk.TimeGrid(fps, num_frames, 3.5),
        local_rotations=rotations,
        root_translation=root,
        captions=(mk.Caption("turns 走", 0.1),),
        sequence_id="a/b",
    )


def without_rotations(motion):
    return replace(motion, local_rotations=None, root_translation=None)


def shaken(motion):
    noise = np.random.default_rng(1).normal(0, 0.02, motion.joint_positions.shape).astype(np.float32)
    return without_rotations(replace(motion, joint_positions=motion.joint_positions + noise))


MOTIONS = {
    "rotations": turning(),
    "kit": turning(mk.KIT21),
    "positions": without_rotations(turning()),
    "positions whose bones change": shaken(turning()),
    "one joint": turning(mk.Skeleton("ball", ("centre",), (-1,), np.zeros((1, 3), np.float32))),
    "one frame": turning(num_frames=1),
    "tips": turning(replace(mk.SMPL22, name="tips", end_sites=((15, (0.0, 0.1, 0.0)), (20, (0.0, -0.1, 0.0))))),
}


@pytest.fixture(params=MOTIONS)
def played(request, tmp_path):
    motion = MOTIONS[request.param]
    write_gltf(motion, tmp_path / "a.glb")
    return motion, Played(tmp_path / "a.glb")


def test_joints_are_where_the_motion_has_them(played):
    motion, file = played
    for frame in range(motion.num_frames):
        world = file.world(frame)
        joints = np.stack([world[joint][:3, 3] for joint in range(motion.skeleton.num_joints)])
        np.testing.assert_allclose(joints, motion.joint_positions[frame], atol=2e-4)


def test_the_body_follows_the_joints(played):
    motion, file = played
    for frame in (0, motion.num_frames - 1):
        vertices, bound = file.vertices(frame)
        for joint in range(motion.skeleton.num_joints):
            own = vertices[bound == joint]
            assert np.linalg.norm(own - motion.joint_positions[frame, joint], axis=1).min() < 0.016
        for joint, parent in enumerate(motion.skeleton.parents[1:], start=1):
            if not np.allclose(motion.skeleton.offsets[joint], 0):
                tip = np.linalg.norm(vertices[bound == joint] - motion.joint_positions[frame, joint], axis=1).min()
                start = np.linalg.norm(vertices[bound == parent] - motion.joint_positions[frame, parent], axis=1).min()
                assert max(tip, start) < 3e-4


def test_the_file_is_as_the_specification_wants_it(played):
    motion, file = played
    document = file.file
    length = document.buffers[0].byteLength
    assert len(file.blob) >= length and len(file.blob) % 4 == 0
    end = 0
    for view in document.bufferViews:
        assert view.byteOffset % 4 == 0 and view.byteOffset >= end
        end = view.byteOffset + view.byteLength
    assert end <= length
    for index, accessor in enumerate(document.accessors):
        values = file.read(index)
        view = document.bufferViews[accessor.bufferView]
        assert values.nbytes == view.byteLength
        if accessor.min:
            np.testing.assert_array_equal(values.min(axis=0), np.float32(accessor.min))
            np.testing.assert_array_equal(values.max(axis=0), np.float32(accessor.max))
    for primitive in document.meshes[0].primitives:
        assert document.accessors[primitive.attributes.POSITION].min
        assert document.accessors[primitive.indices].count % 3 == 0
        assert file.read(primitive.indices).max() < document.accessors[primitive.attributes.POSITION].count
        assert file.read(primitive.attributes.JOINTS_0).max() < motion.skeleton.num_joints
    assert document.accessors[document.animations[0].samplers[0].input].min == [0.0]
    np.testing.assert_allclose(file.seconds[:, 0], np.arange(motion.num_frames) / float(motion.fps), rtol=1e-6)
    for (_, path), values in file.channels.items():
        assert len(values) == motion.num_frames
        if path == "rotation":
            np.testing.assert_allclose(np.linalg.norm(values, axis=1), 1, atol=1e-6)
            assert (np.sum(values[1:] * values[:-1], axis=1) >= 0).all()


def test_what_is_written_is_read_back(played, tmp_path):
    motion, _ = played
    back = read_gltf(tmp_path / "a.glb")
    assert (back.timegrid, back.captions, back.action) == (motion.timegrid, motion.captions, motion.action)
    assert back.skeleton.joint_names == motion.skeleton.joint_names
    np.testing.assert_allclose(back.joint_positions, motion.joint_positions, atol=2e-4)
    if motion.local_rotations is not None:
        assert back.skeleton.parents == motion.skeleton.parents
        np.testing.assert_allclose(
            np.abs(np.sum(back.local_rotations * motion.local_rotations, axis=-1)), 1.0, atol=1e-5
        )


TRANSLATIONS = {
    # Two keys, a second apart; a share of 1/4 and of 3/4 of the way.
    "LINEAR": ([[0, 0, 0], [4, 0, 0]], (1.0, 3.0)),
    "STEP": ([[0, 0, 0], [4, 0, 0]], (0.0, 0.0)),
    # Arriving tangent, value, leaving tangent of each key: x = t³, whose slope is 0, then 3.
    "CUBICSPLINE": ([[9, 9, 9], [0, 0, 0], [0, 0, 0], [3, 0, 0], [1, 0, 0], [9, 9, 9]], (1 / 64, 27 / 64)),
}


def write_nodes(path, interpolation, *, keys=(0.0, 0.25, 0.5, 0.75, 1.0), animated=True):
    """Nodes without a skin below a turned and scaled parent: a hip that is moved by two keys, a knee by short ones."""
    buffer = GlbBuffer()
    moved = buffer.add(np.array(TRANSLATIONS[interpolation][0], np.float32))
    quarter = np.array([[0, 0, np.sin(a), np.cos(a)] for a in np.linspace(0, np.pi / 4, len(keys))])
    turned = buffer.add(np.array(quarter, np.float32))
    samplers = [
        {"input": buffer.add(np.array([[0.0], [1.0]], np.float32)), "output": moved, "interpolation": interpolation},
        {"input": buffer.add(np.array(keys, np.float32)[:, None]), "output": turned},
    ]
    channels = [
        {"sampler": 0, "target": {"node": 1, "path": "translation"}},
        {"sampler": 1, "target": {"node": 2, "path": "rotation"}},
    ]
    half = float(np.sqrt(0.5))
    nodes = [
        {"name": "armature", "rotation": [0, half, 0, half], "scale": [0.5] * 3, "children": [1]},
        {"name": "hip", "children": [2], "scale": [2] * 3},
        {"name": "knee", "translation": [0, 1, 0], "children": [3]},
        {"name": "ankle", "translation": [1, 0, 0]},
    ]
    document = {"asset": {"version": "2.0"}, "nodes": nodes}
    buffer.write(path, document | ({"animations": [{"samplers": samplers, "channels": channels}]} if animated else {}))


@pytest.mark.parametrize("interpolation", TRANSLATIONS)
def test_animated_nodes_without_a_skin_are_a_motion(tmp_path, interpolation):
    write_nodes(tmp_path / "a.glb", interpolation)
    motion = mk.read(tmp_path / "a.glb")
    assert (motion.fps, motion.num_frames, motion.skeleton.joint_names) == (4, 5, ("hip", "knee", "ankle"))
    # The parent turns x to -z and halves it; the hip doubles what is below.
    early, late = (0.5 * value for value in TRANSLATIONS[interpolation][1])
    np.testing.assert_allclose(motion.joint_positions[[1, 3], 0], [[0, 0, -early], [0, 0, -late]], atol=1e-6)
    bent = np.array([[0, 0, -1], [0, half := np.sqrt(0.5), -half], [0, 1, 0]])
    ankles = motion.joint_positions[[0, 2, 4], 2] - motion.joint_positions[[0, 2, 4], 1]
    np.testing.assert_allclose(ankles, bent, atol=1e-6)
    assert motion.local_rotations is not None
    np.testing.assert_allclose(motion.skeleton.offsets[2], [0, 0, -1], atol=1e-6)
    assert mk.read(tmp_path / "a.glb", fps=8).num_frames == 9


def test_a_glb_without_a_motion_is_explained(tmp_path):
    path = tmp_path / "a.glb"
    write_nodes(path, "LINEAR", animated=False)
    assert "no animation" in str(refusal(read_gltf, path))
    write_nodes(path, "LINEAR", keys=(0.0, 0.1, 0.5, 0.75, 1.0))
    assert refusal(read_gltf, path).reason == "frame-time"
    assert read_gltf(path, ReadOptions(fps=Fraction(10))).num_frames == 11
    whole = path.read_bytes()
    for size in (0, 5, 30, len(whole) - 40):
        path.write_bytes(whole[:size])
        assert refusal(read_gltf, path).reason in ("gltf", "empty")
