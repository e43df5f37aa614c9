"""`motionkit info`, `validate`, `query` as a person sees them."""

import json

import pytest

from motionkit.core.skeletons.mapping import map_joints
from motionkit.store import Store
from tests.motionkit.io.test_c3d import points as marker_points
from tests.motionkit.io.test_c3d import write as write_c3d


@pytest.fixture
def store(motionkit, takes, tmp_path):
    (takes / "clips.csv").write_text("file,caption,split\nalpha.bvh,a person slides,train\nbeta.bvh,it slides,test\n")
    motionkit("ingest", takes, "--store", tmp_path / "store", "--workers", 1)
    return tmp_path / "store"


def test_info(motionkit, store):
    outcome = motionkit("info", "--store", store)
    assert outcome.code == 0
    lines = outcome.stdout.splitlines()
    assert lines[0] == f"{store}: 3 sequences, 0.00 h, 15 frames, 1 skeletons"
    for line in (
        "source      takes",
        "fps         30 (3)",
        "splits      none (1), test (1), train (1)",
        "captions    2 on 2 sequences",
        "skeletons   1 with 6 joints",
        "formats     bvh (3)",
    ):
        assert line in lines
    assert lines[-1] == f"fingerprint {Store.open(store).fingerprint}"


def test_info_as_json(motionkit, store):
    summary = json.loads(motionkit("info", "--store", store, "--json").stdout)
    assert summary["num_frames"] == 15
    assert summary["raw_bytes"] == 15 * (6 * 3 + 6 * 4 + 3) * 4
    assert summary["disk_bytes"] == sum(
        path.stat().st_size for path in store.rglob("*.parquet") if "cache" not in path.parts
    )
    assert summary["sources"][0]["framerates"] == {"30": 3}


def test_query(motionkit, store):
    sql = "SELECT sequence_id, num_frames / fps AS seconds, split FROM sequences ORDER BY 1 LIMIT 2"
    as_table = motionkit("query", sql, "--store", store)
    assert as_table.code == 0
    assert "takes/alpha" in as_table.stdout
    assert "0.133333" in as_table.stdout
    as_json = json.loads(motionkit("query", sql, "--store", store, "--json").stdout)
    assert as_json[1] == {"sequence_id": "takes/beta", "seconds": pytest.approx(5 / 30), "split": "test"}


def test_query_over_frames_and_skeletons(motionkit, store):
    sql = (
        "SELECT s.sequence_id, k.name, len(g.joint_positions) AS numbers, s.captions[1].text AS caption, 0.0 / 0 AS no "
        "FROM sequences s JOIN motions g USING (sequence_index) JOIN skeletons k USING (skeleton) ORDER BY 1"
    )
    first = json.loads(motionkit("query", sql, "--store", store, "--json").stdout)[0]
    assert first["numbers"] == 4 * 6 * 3
    assert first["caption"] == "a person slides"
    assert first["no"] is None
    assert "… 72 values]" in motionkit("query", "FROM motions LIMIT 1", "--store", store).stdout


def test_columns_of_one_name_are_distinguished(motionkit, store):
    sql = "SELECT 1 AS a, 2 AS a, 3 AS b, 4 AS a"
    row = {"a": 1, "a_1": 2, "b": 3, "a_2": 4}
    assert json.loads(motionkit("query", sql, "--store", store, "--json").stdout) == [row]


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT nothing FROM sequences",
        "SELEC",
        "",
        "CREATE TABLE mine (a INTEGER)",
        "COPY sequences TO 'stolen.csv'",
        "SELECT * FROM read_text('/etc/passwd')",
        "ATTACH 'other.db'",
        "INSTALL httpfs",
    ],
)
def test_queries_that_fail_or_reach_out(motionkit, store, tmp_path, monkeypatch, sql):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    outcome = motionkit("query", sql, "--store", store)
    assert outcome.code == 2
    assert outcome.stderr.startswith("motionkit: ")
    assert sorted(tmp_path.rglob("*")) == before


def test_validate(motionkit, store):
    intact = motionkit("validate", "--store", store)
    assert (intact.code, intact.stdout) == (0, f"{store} is intact: 3 sequences, 3 files\n")
    part = store / "motions" / "part-00000.parquet"
    content = bytearray(part.read_bytes())
    content[len(content) // 2] ^= 1
    part.write_bytes(content)
    damaged = motionkit("validate", "--store", store)
    assert damaged.code == 1
    assert damaged.stdout == "motions/part-00000.parquet: its sha256 is not the manifest's\n"
    assert json.loads(motionkit("validate", "--store", store, "--json").stdout)["faults"] == [damaged.stdout.strip()]


@pytest.mark.parametrize("command", [("info",), ("validate",), ("query", "FROM sequences"), ("train",)])
def test_no_store(motionkit, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    outcome = motionkit(*command)
    assert outcome.code == 1
    assert outcome.stderr == (
        "motionkit: there is no store at store: make one with 'motionkit ingest SOURCE --store store'\n"
    )


RIG = """
name = "half a body"
requires = ["Hips", "LeftUpLeg", "Head"]
[smpl22]
pelvis = "Hips"
left_hip = "LeftUpLeg"
right_hip = { Hips = 2.0, LeftUpLeg = -1.0 }
spine1 = { Hips = 0.5, Spine = 0.5 }
left_knee = "LeftLeg"
right_knee = "LeftLeg"
spine2 = "Spine"
left_ankle = "LeftFoot"
right_ankle = "LeftFoot"
spine3 = { Spine = 0.5, Head = 0.5 }
neck = { Spine = 0.25, Head = 0.75 }
left_collar = "Spine"
right_collar = "Spine"
head = "Head"
left_shoulder = "Spine"
right_shoulder = "Spine"
left_elbow = "Spine"
right_elbow = "Spine"
left_wrist = "Spine"
right_wrist = "Spine"
"""


def test_a_skeleton_map_stays_with_the_store(motionkit, takes, tmp_path):
    (tmp_path / "half.toml").write_text(RIG)
    (tmp_path / "other.toml").write_text(RIG.replace("half a body", "other").replace('"Head"]', '"Tail"]'))
    store = tmp_path / "mapped"
    outcome = motionkit(
        "ingest", takes, "--store", store, "--skeleton-map", tmp_path / "half.toml",
        "--skeleton-map", tmp_path / "other.toml", "--json",
    )  # fmt: skip
    assert json.loads(outcome.stdout)["warnings"] == {"unused-skeleton-map": 1}
    assert "skeleton map 'other': fits no skeleton of the sources" in outcome.stderr
    opened = Store.open(store)
    motion = opened.read("takes/beta")
    assert motion.skeleton.fingerprint == opened.sequences["skeleton"][0]
    assert map_joints(motion, "smpl22").shape == (5, 22, 3)
    assert motionkit("validate", "--store", store).code == 0
    assert motionkit("ingest", takes, "--store", store).code == 0  # nothing new


def test_a_bad_skeleton_map_is_reported_before_anything_is_read(motionkit, takes, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG.replace("neck = { Spine = 0.25", "neck = { Spine = 0.5"))
    outcome = motionkit("ingest", takes, "--store", tmp_path / "store", "--skeleton-map", path)
    assert outcome.code == 1 and not (tmp_path / "store").exists()
    assert outcome.stderr.endswith("rig.toml: the weights of neck sum to 1.25, expected 1\n")


def test_markers_are_reported_once_and_have_no_bones_to_change(motionkit, tmp_path):
    takes = tmp_path / "markers"
    takes.mkdir()
    for number, labels in enumerate((("A", "B", "C"), ("A", "B", "D"))):
        write_c3d(takes / f"{number}.c3d", 20 * marker_points(), labels)
    store = tmp_path / "s"
    outcome = motionkit("ingest", takes, "--store", store, "--workers", 1, "--json")
    assert json.loads(outcome.stdout)["warnings"] == {"unmapped-skeleton": 1}
    flags = Store.open(store).sequences["quality_flags"]
    assert len(flags) == 2 and all("bone_length" not in found for found in flags)
