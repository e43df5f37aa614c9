"""`motionkit export`: what comes out of a store goes into another one."""

import json
import resource
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io.bvh import write_bvh
from motionkit.io.smpl_body import mean_shape_skeleton
from motionkit.store import Store, StoreWriter


def test_what_files_cannot_hold_comes_back(motionkit, tmp_path):
    captions = (
        Caption('a person walks, "slowly"\u2028and 走'),
        Caption('a person walks, "slowly"\u2028and 走'),
        Caption("stops", 0.1, 0.4, "stops/VERB"),
        Caption("waves", 0.25),
        Caption("from the start", 0.0, 0.3),
    )
    rig = replace(SMPL22, name="rig", joint_names=tuple(f"bone{i}" for i in range(22)))
    said = Provenance(
        source="lab", subset="day 1", licence="CC-BY-4.0", subject="S01", stated_fps="mocap_framerate: 59.9"
    )
    turns = np.tile(np.array([1, 0, 0, 0], np.float32), (20, 22, 1))
    before = Motion(
        forward_kinematics(turns, np.ones((20, 3), np.float32), rig),
        rig,
        TimeGrid(Fraction(60000, 1001), 20),
        local_rotations=turns,
        root_translation=np.ones((20, 3), np.float32),
        captions=captions,
        action="walk",
        style="old",
        split="val",
        sequence_id="deep/er/take",
        provenance=said,
    )
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(before)
    assert motionkit("export", tmp_path / "out", "--store", tmp_path / "store").code == 0
    again = motionkit("ingest", tmp_path / "out", "--store", tmp_path / "again", "--unit-metres", 0.01)
    assert again.code == 0 and "bone0" in again.stderr.removeprefix("warning: ")
    after = Store.open(tmp_path / "again").read("out/deep/er/take")
    assert after.captions == captions
    assert (after.action, after.style, after.split, after.fps) == ("walk", "old", "val", before.fps)
    kept = ("source", "subset", "licence", "subject", "stated_fps")
    assert [getattr(after.provenance, name) for name in kept] == [getattr(said, name) for name in kept]


def test_a_skeleton_without_the_joints_is_left_out_and_reported(motionkit, bodies, tmp_path):
    ball = Skeleton("ball", ("centre",), (-1,), np.zeros((1, 3), np.float32))
    with StoreWriter.append(bodies) as writer:
        writer.add(Motion(np.zeros((9, 1, 3), np.float32), ball, TimeGrid(Fraction(30), 9), sequence_id="ball"))
    arguments = ("--store", bodies, "--format", "joints-npy", "--where", "fps = 30")
    outcome = motionkit("export", tmp_path / "out", *arguments)
    assert outcome.code == 0
    assert "left out: 1 (1 skeleton)" in outcome.stdout
    assert "left out ball: skeleton 'ball' cannot be mapped" in outcome.stderr
    told = json.loads(motionkit("export", tmp_path / "json", *arguments, "--json").stdout)
    assert [(one["sequence_id"], one["reason"]) for one in told["left_out"]] == [("ball", "skeleton")]
    nothing = motionkit("export", tmp_path / "none", *arguments[:-1], "sequence_id = 'ball'")
    assert nothing.code == 1
    assert not list(tmp_path.glob("none*"))


@pytest.mark.parametrize("format", ["bvh", "humanml3d", "parquet"])
def test_a_full_disk_names_the_file_and_leaves_nothing(format, motionkit, bodies, tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
    try:
        outcome = motionkit("export", tmp_path / "out", "--store", bodies, "--format", format, "--fps", "20")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert outcome.code == 1
    assert "Traceback" not in outcome.stderr
    assert "out.partial/out/" in outcome.stderr.replace("\n", "")
    assert not list(tmp_path.glob("out*"))


@pytest.fixture
def bodies(tmp_path):
    """Two motions on the 22 joints, at 30 and at 60 fps."""
    with StoreWriter.create(tmp_path / "store") as writer:
        for name, fps in (("a/slow", 30), ("a/fast", 60)):
            turns = np.tile(np.array([1, 0, 0, 0], np.float32), (40, 22, 1))
            path = np.linspace(0, 1, 120, dtype=np.float32).reshape(40, 3)
            places = forward_kinematics(turns, path, SMPL22)
            writer.add(Motion(places, SMPL22, TimeGrid(Fraction(fps), 40), sequence_id=name))
    return tmp_path / "store"


def test_joints_of_one_framerate(motionkit, bodies, tmp_path):
    out = tmp_path / "out"
    assert motionkit("export", out, "--store", bodies, "--format", "joints-npy", "--where", "fps = 30").code == 0
    np.testing.assert_array_equal(np.load(out / "a_slow.npy"), Store.open(bodies).read("a/slow").joint_positions)
    assert not (out / "a_fast.npy").exists()
    mixed = motionkit("export", tmp_path / "mixed", "--store", bodies, "--format", "joints-npy")
    assert mixed.code == 2
    assert "have 30 and 60: give one with --fps" in mixed.stderr
    assert not list(tmp_path.glob("mixed*"))
    both = motionkit("export", tmp_path / "both", "--store", bodies, "--format", "joints-npy", "--fps", 60, "--json")
    assert both.code == 0
    assert len(np.load(tmp_path / "both" / "a_slow.npy")) == 79
    assert len(np.load(tmp_path / "both" / "a_fast.npy")) == 40


def test_onto_a_character_s_own_file(motionkit, bodies, tmp_path):
    body, turns = mean_shape_skeleton(), np.tile(np.array([1, 0, 0, 0], np.float32), (2, 22, 1))
    root = np.tile(np.array([0, 0.9, 0], np.float32), (2, 1))
    posed = Motion(forward_kinematics(turns, root, body), body, TimeGrid(Fraction(30), 2), turns, root)
    write_bvh(posed, tmp_path / "hero.bvh")
    arguments = ("--store", bodies, "--onto", tmp_path / "hero.bvh")
    outcome = motionkit("export", tmp_path / "out", *arguments, "--plant")
    assert (outcome.code, outcome.stderr) == (0, "")
    heads = [path.read_text().split("MOTION")[0] for path in (tmp_path / "hero.bvh", tmp_path / "out/a/fast.bvh")]
    assert heads[0] == heads[1]
    assert "Frames: 40\nFrame Time: 0.0166" in (tmp_path / "out/a/fast.bvh").read_text()
    other = motionkit("export", tmp_path / "other", *arguments, "--format", "npz")
    assert other.code == 2 and "leave --format out" in other.stderr
    alone = motionkit("export", tmp_path / "alone", "--store", bodies, "--plant")
    assert alone.code == 2 and "go with --onto" in alone.stderr
    (tmp_path / "hero.fbx").write_bytes(b"Kaydara FBX")
    fbx = motionkit("export", tmp_path / "fbx", "--store", bodies, "--onto", tmp_path / "hero.fbx")
    assert fbx.code == 2 and "a character is a .bvh or a .glb file" in fbx.stderr
