"""`motionkit eval` and `motionkit report`, driven by the command line on a small store."""

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.report.results import Cell, format_cell
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.core.timegrid import TimeGrid
from motionkit.store.writer import StoreWriter
from tests.helpers.outcome import Outcome

Command = Callable[..., Outcome]


def walk(seed: int, fps: int, seconds: float) -> np.ndarray:
    """A body that walks with swinging joints and some noise; not a person, but everything moves."""
    rng = np.random.default_rng(seed)
    num_frames = int(seconds * fps)
    time = np.arange(num_frames)[:, None, None] / fps
    swing = 0.03 * np.sin(2 * np.pi * rng.uniform(0.5, 2, (22, 3)) * time + rng.uniform(0, 6, (22, 3)))
    path = np.concatenate((rng.normal(size=1), [0.0], rng.normal(size=1)))
    noise = 0.001 * rng.normal(size=(num_frames, 22, 3))
    return (rest_positions(SMPL22) + [0, 0.95, 0] + swing + path * time + noise).astype(np.float32)


def motion(index: int, fps: int, split: str) -> Motion:
    positions = walk(index, fps, 5.0)
    return Motion(
        joint_positions=positions,
        skeleton=SMPL22,
        timegrid=TimeGrid(Fraction(fps), len(positions)),
        captions=(Caption(f"walk {index}"),),
        split=split,
        sequence_id=f"walk-{index}",
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("eval") / "store"
    with StoreWriter.create(path) as writer:
        for index in range(12):
            writer.add(motion(index, (30, 60, 120)[index % 3], "test" if index % 2 else "train"))
    return path


SMALL = ("--clips", "128", "--replications", "2", "--evaluator", "kinematic")


def test_table_2(motionkit: Command, store: Path, tmp_path: Path) -> None:
    done = motionkit(
        "eval", "--table", "2", "--store", store, "--results", tmp_path, "--fps", "20,60", *SMALL, "--json"
    )
    assert done.code == 0, done.stderr
    result = json.loads(done.stdout)
    block = result["blocks"][0]
    rows = {row["name"]: row["cells"] for row in block["rows"]}
    floor = rows["real, independent draws (P1)"]
    slerp = rows["real kept at 20 fps, SLERP"]
    assert slerp["60 fps"]["value"] > floor["60 fps"]["value"]
    assert slerp["20 fps"] == floor["20 fps"]
    handicapped = rows["real kept at 20 fps, as vectors (handicapped)"]
    assert handicapped["60 fps"]["value"] > slerp["60 fps"]["value"]
    assert rows["real, disjoint halves of the takes (P2)"]["60 fps"]["value"] > floor["60 fps"]["value"]
    assert result["definition"]["real_sets"] == {
        "20 fps": {"sequences": 6, "seconds": 30.0},
        "60 fps": {"sequences": 4, "seconds": 20.0},
    }
    assert set(block["provenance"]["fingerprints"]) == {"20 fps", "60 fps"}
    assert any(line.startswith("NeRM: ") for line in result["missing"])
    assert not any(name.startswith("NeRM") and "(paper)" not in name for name in rows)
    paper = {row["name"]: row["cells"] for row in result["blocks"][-1]["rows"]}
    assert paper["NeRM (paper)"]["120 fps"]["value"] == 1.315
    assert json.loads((tmp_path / "nerm-table2.json").read_text())["version"] == "clip-fid/3"

    cell = format_cell(Cell(slerp["60 fps"]["value"], slerp["60 fps"]["ci95"]))
    assert f"| {cell} |" in (tmp_path / "nerm-table2.md").read_text()
    page = motionkit("report", "--results", tmp_path)
    assert page.code == 0, page.stderr
    assert "clip-FID by framerate" in (tmp_path / "report.html").read_text()
    drawn = motionkit("report", "--results", tmp_path, "--format", "png")
    assert drawn.stdout.split() == [str(tmp_path / "nerm-table2.png")]
    assert (tmp_path / "nerm-table2.png").read_bytes().startswith(b"\x89PNG")


def test_calibration(motionkit: Command, store: Path, tmp_path: Path) -> None:
    arguments = ("--store", store, "--results", tmp_path, "--fps", "60", "--json", *SMALL)
    done = motionkit("eval", "--calibrate", *arguments)
    assert done.code == 0, done.stderr
    result = json.loads(done.stdout)
    ratios, spearman, games = result["blocks"]
    values = {row["name"]: row["cells"]["60 fps"]["value"] for row in ratios["rows"]}
    assert values["jitter 0.01 m"] > values["jitter 0.005 m"] > 1.0
    assert values["flat: yaw"] == pytest.approx(1.0, abs=0.05)
    correlations = {row["name"]: row["cells"]["60 fps"]["value"] for row in spearman["rows"]}
    assert correlations["jitter"] == pytest.approx(1.0)
    assert values["disjoint halves of the takes (P2)"] > 1.0
    jitter = next(row for row in spearman["rows"] if row["name"] == "jitter")
    assert "0.0005 m (60 fps)" in jitter["note"]
    timing = {row["name"]: row["cells"]["T"]["value"] for row in games["rows"]}
    assert abs(timing["low-passed at 8 Hz"]) < 0.2
    assert len(timing) == 68


def test_sets_that_mislead_are_named_under_the_table(motionkit: Command, store: Path, tmp_path: Path) -> None:
    """The real files as another system's, fewer clips than features."""
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "motions.json").write_text('{"fps": 120}')
    for index in (5, 11):
        np.save(tmp_path / "copy" / f"walk-{index}.npy", walk(index, 120, 5.0))
    samples = ("--samples", f"copy={tmp_path / 'copy'}")
    arguments = ("--clips", "64", "--replications", "2", "--evaluator", "kinematic", "--sizes", "16:32", "--json")
    done = motionkit(
        "eval", "--table", "2", "--store", store, "--results", tmp_path, "--fps", "120", *samples, *arguments
    )
    assert done.code == 0, done.stderr
    result = json.loads(done.stdout)
    notes = "\n".join(result["notes"])
    assert "copy, 120 fps: 2 of 2 sequences are copies of sequences of real (test)" in notes
    details = result["blocks"][0]["rows"][0]["cells"]["120 fps"]["details"]
    assert {"KID", "precision", "recall", "density", "coverage"} < set(details)
    # Too few clips for a line through covariances that are not singular.
    assert "FID_∞" not in details
    assert result["definition"]["protocol"]["max_poses"] == 32


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("eval",), 2, "give --table NUMBER, --figure NUMBER or --calibrate; installed tables: nerm-"),
        (("eval", "--table", "2", "--figure", "5"), 2, "give --table NUMBER, --figure NUMBER or --calibrate"),
        (("eval", "--table", "77"), 2, "there is no table 77 of 'nerm'"),
        (("eval", "--table", "2", "--fps", "20,x"), 2, "--fps 20,x"),
        (("eval", "--table", "2", "--sizes", "64:16"), 2, "--sizes 64:16"),
        (("eval", "--table", "2", "--samples", "mine"), 2, "give NAME=DIR"),
        (("eval", "--calibrate", "--samples", "a=b"), 2, "leave out --samples"),
        (("eval", "--table", "2", "--store", "nowhere"), 1, "nowhere"),
        (("report", "--results", "nowhere"), 2, "there is no result in 'nowhere'"),
    ],
)
def test_faults_are_one_line(motionkit: Command, arguments: tuple[str, ...], code: int, message: str) -> None:
    done = motionkit(*arguments)
    assert (done.code, done.stdout) == (code, "")
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
