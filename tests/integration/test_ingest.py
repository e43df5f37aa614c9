"""`motionkit ingest` on good and bad files: one clear line for each fault, and a store of exactly the good ones."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from motionkit.store import Store
from tests.helpers.every_format import SOURCES
from tests.helpers.format_samples import TWO_JOINTS, bvh_hierarchy, bvh_text


def ids(store: Path) -> list[str]:
    return list(Store.open(store).sequences["sequence_id"])


def test_the_first_ingest_makes_a_store_and_the_next_adds_to_it(motionkit, takes, tmp_path):
    store = tmp_path / "store"
    first = motionkit("ingest", takes, "--store", store, "--workers", 1)
    assert (first.code, first.stderr) == (0, "")
    assert first.stdout.startswith("stored 3 sequences (0.00 h, 15 frames) in ")
    assert ids(store) == ["takes/alpha", "takes/beta", "takes/gamma"]
    assert Store.open(store).read("takes/beta").fps == 30
    (takes / "delta.bvh").write_text(bvh_text(7))
    second = motionkit("ingest", takes, "--store", store, "--workers", 1)
    assert (second.code, second.stderr) == (0, "")
    assert second.stdout.startswith("stored 1 sequences (0.00 h, 7 frames) in ")
    assert "already there: 3" in second.stdout
    assert ids(store)[3:] == ["takes/delta"]
    assert motionkit("validate", "--store", store).code == 0


BAD_FILES = {
    "truncated": bvh_text(8)[:-400],
    "channels": bvh_text([[0.0] * 50] * 2),
    "nan": bvh_text().replace("\n0 95 4", "\n0 nan 4"),
    "zero-time": bvh_text(frame_time="0"),
    "no-time": bvh_text().replace("Frame Time: 0.0333333\n", ""),
    "photo": "\x89PNG\r\n\x1a\n",
    "nothing": "",
}


def test_all_of_it_at_once_counted_by_reason(motionkit, takes, tmp_path):
    for name, text in BAD_FILES.items():
        (takes / f"bad-{name}.bvh").write_text(text, encoding="latin-1")
    (takes / "clips.csv").write_text("file,caption\nalpha.bvh,a person slides\nghost.bvh,a ghost slides\n")
    (takes / "rope.bvh").write_text(bvh_text(["0 0 0 0 0 0 0 0 0"], head=bvh_hierarchy(TWO_JOINTS)))
    (tmp_path / "empty").mkdir()
    outcome = motionkit("ingest", takes, tmp_path / "empty", "--store", tmp_path / "store", "--json", "--workers", 1)
    summary = json.loads(outcome.stdout)
    assert outcome.code == 0
    assert summary["stored"] == 4
    assert summary["failed"] == {
        "frame-time": 2,
        "truncated": 1,
        "channel-count": 1,
        "nan": 1,
        "not-what-it-says": 1,
        "empty": 1,
        "caption-without-motion": 1,
        "empty-folder": 1,
    }
    assert summary["warnings"] == {"unmapped-skeleton": 1}
    lines = outcome.stderr.splitlines()
    assert len(lines) - 1 == len(summary["problems"]) == 9
    assert any("ghost.bvh" in line and "line 3" in line for line in lines)
    assert any(line.startswith(f"{tmp_path}/empty: ") for line in lines)
    assert ids(tmp_path / "store") == ["takes/alpha", "takes/beta", "takes/gamma", "takes/rope"]


def test_duplicate_ids(motionkit, takes, tmp_path):
    """The same id in one ingest, and in the store from another file."""
    shutil.copy(takes / "alpha.bvh", takes / "alpha.BVH")
    store = tmp_path / "store"
    first = motionkit("ingest", takes, "--store", store, "--workers", 1)
    assert first.code == 0
    assert "'takes/alpha' is already taken by" in first.stderr
    assert "failed: 1 (1 duplicate-id)" in first.stdout
    other = tmp_path / "other" / "takes"
    other.mkdir(parents=True)
    (other / "beta.bvh").write_text(bvh_text(9))
    second = motionkit("ingest", other, "--store", store, "--workers", 1)
    assert second.code == 1
    assert "already holds a sequence with the id 'takes/beta'" in second.stderr
    assert Store.open(store).read("takes/beta").num_frames == 5


@pytest.fixture
def arrays(tmp_path: Path) -> Path:
    """Ten arrays of which one is a motion."""
    folder = tmp_path / "arrays"
    folder.mkdir()
    np.savez(folder / "motion.npz", joint_positions=np.random.default_rng(0).random((5, 22, 3)), fps=30)
    for number in range(6):
        np.savez(folder / f"unknown-{number}.npz", xyz=np.zeros((5, 22, 3)))
    for number in range(3):
        np.save(folder / f"unknown-{number}.npy", np.zeros((5, 66)))
    return folder


def test_the_last_line_counts_what_was_ignored(motionkit, arrays, tmp_path):
    outcome = motionkit("ingest", arrays, "--store", tmp_path / "store")
    assert outcome.code == 0 and outcome.stdout.startswith("stored 1 sequence")
    (line,) = [line for line in outcome.stdout.splitlines() if line.startswith("ignored")]
    assert line == f"ignored: 9 (6 .npz, 3 .npy; the first: {arrays}/unknown-0.npy)"
    summary = json.loads(motionkit("ingest", arrays, "--store", tmp_path / "store", "--json").stdout)
    assert summary["ignored"] == {".npz": 6, ".npy": 3}
    assert sorted(summary["ignored_paths"]) == sorted(map(str, arrays.glob("unknown*")))


@pytest.mark.parametrize("workers", [1, 2])
def test_of_files_of_one_name_the_first_is_read(motionkit, tmp_path, workers):
    folder = tmp_path / "takes"
    folder.mkdir()
    SOURCES["c3d"](folder)
    SOURCES["npz"](folder)
    (folder / "take.bvh").write_text(bvh_text())
    for code, counted in ((0, "stored 1 sequence"), (1, "already there: 1")):
        outcome = motionkit("ingest", folder, "--store", tmp_path / "store", "--workers", workers)
        assert outcome.code == code
        assert counted in outcome.stdout and "failed: 2 (2 duplicate-id)" in outcome.stdout
        assert list(Store.open(tmp_path / "store").sequences["source_path"]) == ["take.bvh"]
    (folder / "take.bvh").write_text(bvh_text()[:-30])
    outcome = motionkit("ingest", folder, "--store", tmp_path / "other", "--workers", workers)
    assert outcome.code == 1 and "failed: 3 (2 duplicate-id, 1 truncated)" in outcome.stdout


def test_the_real_captures(motionkit, captures, tmp_path):
    """Five tools' BVH files at four framerates keep their framerates."""
    outcome = motionkit("ingest", captures / "mixed-bvh", "--store", tmp_path / "store")
    assert outcome.code == 0
    frame = Store.open(tmp_path / "store").sequences
    assert {f"{n}/{d}" for n, d in zip(frame["fps_numerator"], frame["fps_denominator"], strict=True)} == {
        "30/1",
        "100/1",
        "120000/1001",
        "120/1",
    }
    assert motionkit("validate", "--store", tmp_path / "store").code == 0
