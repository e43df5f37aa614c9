"""`motionkit info FILE`, and a store named by position: whole commands on small files."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.format_samples import bvh_text

TAKE = bvh_text([[0.0, 95.0, 2.0 * frame, *[0.0] * 48] for frame in range(60)])


@pytest.fixture
def take(tmp_path: Path) -> Path:
    path = tmp_path / "takes" / "walk.bvh"
    path.parent.mkdir()
    path.write_text(TAKE)
    return path


@pytest.fixture
def store(motionkit, take: Path, tmp_path: Path) -> Path:
    path = tmp_path / "store"
    assert motionkit("ingest", take.parent, "--store", path, "--workers", 1).code == 0
    (path / "cache" / "native").mkdir(parents=True)
    np.save(path / "cache" / "native" / "positions.npy", np.zeros((60, 16, 3), np.float32))
    return path


def test_a_file_is_described(motionkit, take: Path) -> None:
    shown = dict(line.split(maxsplit=1) for line in motionkit("info", take).stdout.splitlines()[1:])
    assert shown["fps"].startswith("30 ") and shown["frames"] == "60, 2 s" and shown["up"] == "y"
    assert shown["unit"].startswith("0.01 m") and shown["skeleton"].startswith("walk: 16 joints, rotations")
    found = json.loads(motionkit("info", take, "--json").stdout)
    expected = {
        "fps": "30",
        "num_frames": 60,
        "duration_seconds": 2.0,
        "unit_metres": 0.01,
        "up": "y",
        "num_joints": 16,
    }
    assert {key: found[key] for key in expected} == expected
    assert found["height_metres"] == pytest.approx(1.48, abs=0.02)
    assert shown["height"].startswith(f"{found['height_metres']:.3g} m")


@pytest.mark.parametrize("command", [("info",), ("validate",), ("split", "--by", "sequence_id", "--shares", "test=1")])
def test_a_store_is_named_by_position_or_option_alike(motionkit, store: Path, command: tuple[str, ...]) -> None:
    by_option = motionkit(*command, "--store", store, "--json")
    by_position = motionkit(*command, store, "--json")
    assert by_option.code == by_position.code == 0
    one, other = json.loads(by_option.stdout), json.loads(by_position.stdout)
    assert one.keys() == other.keys() and str(store) in (one.get("store"), one.get("path"))
    assert motionkit(*command, store, "--store", store).code == 2


def test_a_store_is_no_source(motionkit, store: Path, tmp_path: Path) -> None:
    """Neither by its name, nor where it lies inside a folder of motions: its caches are not motions."""
    outcome = motionkit("ingest", store, "--store", tmp_path / "other")
    assert outcome.code == 2 and "merge" in outcome.stderr and "positions.npy" not in outcome.stderr
    report = json.loads(motionkit("ingest", tmp_path, "--store", tmp_path / "other", "--json", "--workers", 1).stdout)
    assert (report["stored"], report["problems"], report["ignored"]) == (1, [], {})
    (store / "sequences.parquet").unlink()  # damaged, and a store all the same
    assert motionkit("ingest", store, "--store", tmp_path / "third").code == 2
