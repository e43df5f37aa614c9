"""`motionkit ingest` says what it has not read, and exits with 1 where it has stored nothing and something was bad."""

import json
from pathlib import Path

import numpy as np
import pytest

from motionkit.store import Store
from tests.helpers.every_format import SOURCES
from tests.helpers.small_bvh import bvh_text


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
