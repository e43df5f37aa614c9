"""`motionkit info`, `validate`, `query`, `remove`, `compact`, `merge` and `export` as a person sees them."""

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.io.bvh import write_bvh
from motionkit.io.smpl_body import mean_shape_skeleton
from motionkit.store import Store, StoreWriter
from tests.helpers.analytic import capture
from tests.helpers.format_samples import bvh_text


@pytest.fixture
def store(motionkit, takes, tmp_path):
    """Three files in three small parts."""
    (takes / "clips.csv").write_text("file,caption,split\nalpha.bvh,a person slides,train\nbeta.bvh,it slides,test\n")
    for path in sorted(takes.glob("*.bvh")):
        motionkit("ingest", path, "--store", tmp_path / "store", "--workers", 1, "--captions", takes / "clips.csv")
    return tmp_path / "store"


def ids(store):
    return Store.open(store).sequences["sequence_id"].tolist()


def test_info_of_a_store(motionkit, store):
    outcome = motionkit("info", "--store", store)
    assert outcome.code == 0
    lines = outcome.stdout.splitlines()
    assert lines[0] == f"{store}: 3 sequences, 0.5 s, 15 frames, 1 skeleton"
    assert {
        "fps         30 (3)",
        "splits      none (1), test (1), train (1)",
        "captions    2 on 2 sequences",
        "skeletons   1 with 16 joints",
        "formats     bvh (3)",
    } <= set(lines)
    assert lines[-1] == f"fingerprint {Store.open(store).fingerprint}"


def test_info_of_a_file(motionkit, tmp_path):
    path = tmp_path / "walk.bvh"
    path.write_text(bvh_text([[0.0, 95.0, 2.0 * frame, *[0.0] * 48] for frame in range(60)]))
    printed = dict(line.split(maxsplit=1) for line in motionkit("info", path).stdout.splitlines()[1:])
    assert printed["fps"].startswith("30 ") and printed["frames"] == "60, 2 s" and printed["up"] == "y"
    report = json.loads(motionkit("info", path, "--json").stdout)
    expected = {"fps": "30", "num_frames": 60, "duration_seconds": 2.0, "unit_metres": 0.01, "up": "y"}
    assert expected.items() <= report.items() and report["num_joints"] == 16
    assert report["height_metres"] == pytest.approx(1.48, abs=0.02)
    assert printed["height"].startswith(f"{report['height_metres']:.3g} m")


def test_info_quality_names_sequences_frames_and_framerates(motionkit, tmp_path):
    good, glitch, slow = (capture(Fraction(fps), "walk", 4.0, seed=3) for fps in (60, 60, 24))
    positions = glitch.joint_positions.copy()
    positions[90, 20] += 0.8
    with StoreWriter.create(tmp_path / "store") as writer:
        for motion, name, source, stated in (
            (good, "good", "ours", "60"),
            (replace(glitch, joint_positions=positions), "glitch", "ours", "60"),
            (slow.resample(120), "slow", "theirs", "0.0083333"),
        ):
            writer.add(replace(motion, sequence_id=name, provenance=Provenance(source=source, stated_fps=stated)))
    outcome = motionkit("info", "--quality", "--store", tmp_path / "store")
    assert outcome.code == 0, outcome.stderr
    lines = outcome.stdout.splitlines()
    assert "           2 jumps  glitch, at 1.500 s (frame 90)" in lines
    assert "          24 fps  slow" in lines
    report = json.loads(motionkit("info", "--quality", "--json", "--store", tmp_path / "store").stdout)
    ours, theirs = report["sources"]
    assert ours["clean"]["num_sequences"] == ours["flags"]["teleport"]["num_sequences"] == 1
    assert theirs["flags"]["upsampled"]["num_sequences"] == 1
    [worst] = [each for each in report["worst"] if each["flag"] == "teleport"]
    assert worst["offenders"] == [{"sequence_id": "glitch", "value": 2.0, "seconds": 1.5, "frame": 90}]


def test_query(motionkit, store):
    sql = "SELECT sequence_id, num_frames / fps AS seconds, split FROM sequences ORDER BY 1 LIMIT 2"
    table = motionkit("query", sql, "--store", store)
    assert table.code == 0 and ids(store)[0] in table.stdout and "0.133333" in table.stdout
    rows = json.loads(motionkit("query", sql, "--store", store, "--json").stdout)
    assert rows[1] == {"sequence_id": ids(store)[1], "seconds": pytest.approx(5 / 30), "split": "test"}


def test_validate(motionkit, store):
    intact = motionkit("validate", "--store", store)
    assert (intact.code, intact.stdout) == (0, f"{store} is intact: 3 sequences, 5 files\n")
    path = store / "motions" / "part-00000.parquet"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    damaged = motionkit("validate", "--store", store)
    assert damaged.code == 1 and damaged.stdout.startswith("motions/part-00000.parquet: ")
    assert json.loads(motionkit("validate", "--store", store, "--json").stdout)["faults"] == [damaged.stdout.strip()]


@pytest.mark.parametrize("command", [("info",), ("validate",), ("query", "FROM sequences"), ("train",)])
def test_a_missing_store_is_named_with_the_command_that_makes_one(motionkit, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    outcome = motionkit(*command)
    assert outcome.code == 1 and "motionkit ingest SOURCE --store store" in outcome.stderr


@pytest.mark.parametrize("command", [("info",), ("validate",), ("split", "--by", "sequence_id", "--shares", "test=1")])
def test_a_store_is_named_by_position_or_option_alike(motionkit, store, command):
    by_option, by_position = (motionkit(*command, *place, "--json") for place in (("--store", store), (store,)))
    assert by_option.code == by_position.code == 0
    one, other = json.loads(by_option.stdout), json.loads(by_position.stdout)
    assert one.keys() == other.keys() and str(store) in (one.get("store"), one.get("path"))
    assert motionkit(*command, store, "--store", store).code == 2


def test_a_store_is_no_source(motionkit, store, takes, tmp_path):
    """Neither by its name, nor where it lies inside a folder of motions: its caches are not motions."""
    (store / "cache" / "native").mkdir(parents=True)
    np.save(store / "cache" / "native" / "positions.npy", np.zeros((60, 16, 3), np.float32))
    outcome = motionkit("ingest", store, "--store", tmp_path / "other")
    assert outcome.code == 2 and "merge" in outcome.stderr and "positions.npy" not in outcome.stderr
    report = json.loads(motionkit("ingest", tmp_path, "--store", tmp_path / "other", "--json", "--workers", 1).stdout)
    assert (report["stored"], report["problems"], report["ignored"]) == (3, [], {})
    Path(store / "sequences.parquet").unlink()  # damaged, and a store all the same
    assert motionkit("ingest", store, "--store", tmp_path / "third").code == 2


def test_remove_and_compact(motionkit, store):
    first, second, third = ids(store)
    outcome = motionkit("remove", second, "--store", store)
    assert (outcome.code, outcome.stdout) == (0, f"removed 1 sequence from {store}, which holds 2\n")
    assert ids(store) == [first, third]
    outcome = motionkit("compact", "--store", store)
    assert outcome.code == 0 and outcome.stdout.startswith(f"{store}: 2 parts, ")
    assert motionkit("compact", "--store", store).stdout == f"{store} is compact already\n"
    assert motionkit("validate", "--store", store).code == 0
    removed = json.loads(motionkit("remove", "--where", "num_frames = 6", "--store", store, "--json").stdout)
    counts = {"sequences_in_store": 1, "sequences_to_compact": 1}
    assert removed == {"store": str(store), "removed": [third], **counts}


def test_merge(motionkit, store, tmp_path):
    few = tmp_path / "few"
    outcome = motionkit("merge", few, store, "--where", "num_frames < 6")
    assert (outcome.code, outcome.stdout) == (0, f"stored 2 sequences in {few}, which holds 2\n")
    report = json.loads(motionkit("merge", few, store, "--json").stdout)
    counts = {"stored": 1, "already_stored": 2, "sequences_in_store": 3}
    assert report == {"store": str(few), **counts}
    assert ids(few) == ids(store)


def test_what_files_cannot_hold_comes_back(motionkit, tmp_path):
    captions = (
        Caption('a person walks, "slowly"\u2028and 走'),
        Caption('a person walks, "slowly"\u2028and 走'),
        Caption("stops", 0.1, 0.4, "stops/VERB"),
        Caption("waves", 0.25),
        Caption("from the start", 0.0, 0.3),
    )
    rig = replace(mk.SMPL22, name="rig", joint_names=tuple(f"bone{i}" for i in range(22)))
    said = Provenance(
        source="lab", subset="day 1", licence="CC-BY-4.0", subject="S01", stated_fps="mocap_framerate: 59.9"
    )
    turns = np.tile(np.array([1, 0, 0, 0], np.float32), (20, 22, 1))
    before = Motion(
        forward_kinematics(turns, np.ones((20, 3), np.float32), rig),
        rig,
        mk.TimeGrid(Fraction(60000, 1001), 20),
        local_rotations=turns,
        root_translation=np.ones((20, 3), np.float32),
        captions=captions,
        action="walk",
        style="old",
        split="val",
        sequence_id="deep/er/take",
        provenance=said,
    )
    with mk.StoreWriter.create(tmp_path / "store") as writer:
        writer.add(before)
    assert motionkit("export", tmp_path / "out", "--store", tmp_path / "store").code == 0
    again = motionkit("ingest", tmp_path / "out", "--store", tmp_path / "again", "--unit-metres", 0.01)
    assert again.code == 0 and "bone0" in again.stderr.removeprefix("warning: ")
    after = mk.Store.open(tmp_path / "again").read("out/deep/er/take")
    assert after.captions == captions
    assert (after.action, after.style, after.split, after.fps) == ("walk", "old", "val", before.fps)
    kept = ("source", "subset", "licence", "subject", "stated_fps")
    assert [getattr(after.provenance, name) for name in kept] == [getattr(said, name) for name in kept]


def test_a_skeleton_without_the_joints_is_left_out_and_reported(motionkit, bodies, tmp_path):
    ball = mk.Skeleton("ball", ("centre",), (-1,), np.zeros((1, 3), np.float32))
    with mk.StoreWriter.append(bodies) as writer:
        writer.add(Motion(np.zeros((9, 1, 3), np.float32), ball, mk.TimeGrid(Fraction(30), 9), sequence_id="ball"))
    arguments = ("--store", bodies, "--format", "joints-npy", "--where", "fps = 30")
    outcome = motionkit("export", tmp_path / "out", *arguments)
    assert outcome.code == 0
    assert "left out: 1 (1 skeleton)" in outcome.stdout
    assert "left out ball: skeleton 'ball' cannot be mapped" in outcome.stderr
    again = motionkit("export", tmp_path / "out", *arguments)
    assert again.code == 2 and "--overwrite replaces it" in again.stderr
    assert motionkit("export", tmp_path / "out", *arguments, "--overwrite").code == 0
    foreign = motionkit("export", tmp_path, *arguments, "--overwrite")
    assert foreign.code == 2 and "not what this command writes" in foreign.stderr
    told = json.loads(motionkit("export", tmp_path / "json", *arguments, "--json").stdout)
    assert [(one["sequence_id"], one["reason"]) for one in told["left_out"]] == [("ball", "skeleton")]
    nothing = motionkit("export", tmp_path / "none", *arguments[:-1], "sequence_id = 'ball'")
    assert nothing.code == 1
    assert not list(tmp_path.glob("none*"))


@pytest.fixture
def bodies(tmp_path):
    """Two motions on the 22 joints, at 30 and at 60 fps."""
    with mk.StoreWriter.create(tmp_path / "store") as writer:
        for name, fps in (("a/slow", 30), ("a/fast", 60)):
            turns = np.tile(np.array([1, 0, 0, 0], np.float32), (40, 22, 1))
            path = np.linspace(0, 1, 120, dtype=np.float32).reshape(40, 3)
            places = forward_kinematics(turns, path, mk.SMPL22)
            writer.add(Motion(places, mk.SMPL22, mk.TimeGrid(Fraction(fps), 40), sequence_id=name))
    return tmp_path / "store"


def test_joints_of_one_framerate(motionkit, bodies, tmp_path):
    out = tmp_path / "out"
    assert motionkit("export", out, "--store", bodies, "--format", "joints-npy", "--where", "fps = 30").code == 0
    np.testing.assert_array_equal(np.load(out / "a_slow.npy"), mk.Store.open(bodies).read("a/slow").joint_positions)
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
    posed = Motion(forward_kinematics(turns, root, body), body, mk.TimeGrid(Fraction(30), 2), turns, root)
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
