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
    assert found["height_metres"] == pytest.approx(1.48, abs=0.02) and len(found["joints"]) == 16
    assert shown["height"].startswith(f"{found['height_metres']:.3g} m")


def test_the_axes_of_a_file_are_shown(motionkit, take: Path) -> None:
    rows = [[0.0, -2.0 * frame, 95.0, 0.0, 90.0, *[0.0] * 46] for frame in range(60)]
    take.write_text(bvh_text(rows))
    assert json.loads(motionkit("info", take, "--json").stdout)["up"] == "z"
    given = json.loads(motionkit("info", take, "--up", "y", "--json").stdout)
    assert given["up"] == "y" and "lying" in given["quality_flags"]


def test_the_axis_that_points_up_is_an_option_of_ingest_and_view(motionkit, take: Path, tmp_path: Path) -> None:
    for up, flags in ((), {}), (("--up", "z"), {"lying": 1}):
        name = tmp_path / f"store-{len(up)}"
        report = json.loads(motionkit("ingest", take, "--store", name, "--workers", 1, "--json", *up).stdout)
        assert {flag: count for flag, count in report["quality_flags"].items() if flag == "lying"} == flags
        shown = motionkit("view", take, "--out", tmp_path / f"{len(up)}.html", *up)
        assert shown.code == 0, shown.stderr
    assert (tmp_path / "0.html").read_text() != (tmp_path / "2.html").read_text()
    assert motionkit("view", take, "--up", "-y").code == 2


def test_a_file_without_a_framerate_is_described(motionkit, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    np.save(tmp_path / "a.npy", rng.normal(size=(40, 22, 3)).astype(np.float32))
    found = json.loads(motionkit("info", tmp_path / "a.npy", "--json").stdout)
    assert (found["fps"], found["duration_seconds"], found["num_frames"]) == (None, None, 40)
    assert "--fps" in motionkit("info", tmp_path / "a.npy").stdout


@pytest.mark.parametrize("command", [("info",), ("validate",), ("split", "--by", "sequence_id", "--shares", "test=1")])
def test_a_store_is_named_by_position_or_option_alike(motionkit, store: Path, command: tuple[str, ...]) -> None:
    by_option = motionkit(*command, "--store", store, "--json")
    by_position = motionkit(*command, store, "--json")
    assert by_option.code == by_position.code == 0
    one, other = json.loads(by_option.stdout), json.loads(by_position.stdout)
    assert one.keys() == other.keys() and str(store) in (one.get("store"), one.get("path"))
    assert motionkit(*command, store, "--store", store).code == 2


def test_a_store_to_train_from_is_named_by_position(motionkit, tmp_path: Path) -> None:
    outcome = motionkit("train", tmp_path / "nowhere")
    assert outcome.code == 1 and f"no store at {tmp_path / 'nowhere'}" in outcome.stderr


def test_a_store_is_viewed_by_its_sequences(motionkit, store: Path, tmp_path: Path) -> None:
    outcome = motionkit("view", store, "--out", tmp_path / "page.html", "--json")
    assert outcome.code == 0, outcome.stderr
    assert [motion["name"] for motion in json.loads(outcome.stdout)["motions"]] == ["takes/walk"]


def test_a_store_is_no_source(motionkit, store: Path, tmp_path: Path) -> None:
    """Neither by its name, nor where it lies inside a folder of motions: its caches are not motions."""
    outcome = motionkit("ingest", store, "--store", tmp_path / "other")
    assert outcome.code == 2 and "merge" in outcome.stderr and "positions.npy" not in outcome.stderr
    report = json.loads(motionkit("ingest", tmp_path, "--store", tmp_path / "other", "--json", "--workers", 1).stdout)
    assert (report["stored"], report["problems"], report["ignored"]) == (1, [], {})
    (store / "sequences.parquet").unlink()  # damaged, and a store all the same
    assert motionkit("ingest", store, "--store", tmp_path / "third").code == 2
