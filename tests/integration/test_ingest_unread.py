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


def test_nothing_is_said_where_nothing_was_ignored(motionkit, takes, tmp_path):
    store = takes / "store"  # what is in it is no source
    motionkit("ingest", takes, "--store", store)
    again = motionkit("ingest", takes, "--store", store)
    assert (again.code, "ignored" in again.stdout) == (0, False)
    summary = json.loads(motionkit("ingest", takes, "--store", store, "--json").stdout)
    assert (summary["ignored"], summary["ignored_paths"]) == ({}, [])


def test_an_array_named_singly_is_reported_with_what_it_holds(motionkit, arrays, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = motionkit("ingest", "arrays/unknown-0.npz", "--store", tmp_path / "store")
    assert outcome.code == 1
    assert outcome.error_lines[0].startswith("arrays/unknown-0.npz: of no known format (an archive of xyz), expected ")


@pytest.mark.parametrize("on_error", ["skip", "stop"])
def test_an_ingest_that_stored_nothing_and_failed_exits_1(motionkit, takes, tmp_path, on_error):
    store = tmp_path / "store"
    motionkit("ingest", takes, "--store", store)
    (takes / "broken.bvh").write_text(bvh_text()[:-30])
    outcome = motionkit("ingest", takes, "--store", store, "--on-error", on_error)
    assert outcome.code == 1
    assert outcome.error_lines[-1].endswith(f"the store {store} is as it was")
    assert len(Store.open(store).sequences) == 3


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


def test_under_stop_two_files_of_one_name_are_a_problem(motionkit, takes, tmp_path):
    np.savez(takes / "alpha.npz", joint_positions=np.zeros((5, 22, 3)), fps=30)
    outcome = motionkit("ingest", takes, "--store", tmp_path / "store", "--on-error", "stop")
    assert outcome.code == 1 and "is already taken by alpha.bvh" in outcome.error_lines[0]


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs a file that opens and cannot be read")
@pytest.mark.parametrize("name", ["table.csv", "walk.bvh", "walk.npy", "walk.npz", "walk.amc", "walk.c3d", "train.txt"])
def test_a_file_that_cannot_be_read_is_named_and_costs_no_other(motionkit, takes, tmp_path, name):
    """Reading fails with the system's error for a broken disk, which names no file."""
    (takes / name).symlink_to("/proc/self/mem")
    outcome = motionkit("ingest", takes, "--store", tmp_path / "store", "--workers", 1, "--json")
    report = json.loads(outcome.stdout)
    assert (outcome.code, report["stored"]) == (0, 3)
    assert name in outcome.stderr or f".{name.split('.')[1]}" in report["ignored"]
    alone = motionkit("ingest", takes / name, "--store", tmp_path / "other")
    assert alone.code == 1 and name in alone.stderr
