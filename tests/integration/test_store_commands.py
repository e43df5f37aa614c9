"""`motionkit info`, `validate`, `query`, `remove`, `compact` and `merge` as a person sees them."""

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.motion import Provenance
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
    assert lines[0] == f"{store}: 3 sequences, 0.00 h, 15 frames, 1 skeletons"
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
    assert "  120 (stated as 0.0083333) → 24 fps  slow" in lines
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


@pytest.mark.parametrize("sql", ["SELEC", "COPY sequences TO 'stolen.csv'", "SELECT * FROM read_text('/etc/passwd')"])
def test_queries_that_fail_or_reach_out(motionkit, store, tmp_path, monkeypatch, sql):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    outcome = motionkit("query", sql, "--store", store)
    assert outcome.code == 2 and outcome.stderr.startswith("motionkit: ")
    assert sorted(tmp_path.rglob("*")) == before


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
    assert (outcome.code, outcome.stdout) == (0, f"removed 1 sequences from {store}, which holds 2\n")
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
