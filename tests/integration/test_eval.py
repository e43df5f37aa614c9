"""`motionkit eval` and `motionkit report` on a small store, and with the samples of published layouts."""

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from eval.report.results import Cell, format_cell
from tests.helpers import published_layouts as published
from tests.helpers.analytic import ACTIONS, capture
from tests.helpers.outcome import Outcome

Command = Callable[..., Outcome]


def take(index: int) -> mk.Motion:
    """Five seconds of an action at 30, 60 or 120 fps, with some noise."""
    fps = (30, 60, 120)[index % 3]
    motion = capture(Fraction(fps), list(ACTIONS)[index % len(ACTIONS)], 5.0, 0.001, index).frames(0, 5 * fps)
    split = "test" if index % 2 else "train"
    return replace(motion, captions=(mk.Caption("a person moves"),), split=split, sequence_id=f"take-{index}")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("eval") / "store"
    with mk.StoreWriter.create(path) as writer:
        for index in range(12):
            writer.add(take(index))
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
    done = motionkit("eval", "--calibrate", "--store", store, "--results", tmp_path, "--fps", "60", "--json", *SMALL)
    assert done.code == 0, done.stderr
    ratios, _, games = json.loads(done.stdout)["blocks"]
    values = {row["name"]: row["cells"]["60 fps"]["value"] for row in ratios["rows"]}
    assert values["jitter 0.01 m"] > values["jitter 0.005 m"] > 1.0 and len(games["rows"]) == 68


def test_a_table_of_samples_with_fewer_clips_than_features(motionkit: Command, store: Path, tmp_path: Path) -> None:
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "motions.json").write_text('{"fps": 120}')
    for index in (5, 11):
        np.save(tmp_path / "copy" / f"take-{index}.npy", take(index).joint_positions)
    samples = ("--samples", f"copy={tmp_path / 'copy'}")
    arguments = ("--clips", "64", "--replications", "2", "--evaluator", "kinematic", "--sizes", "16:32", "--json")
    done = motionkit(
        "eval", "--table", "2", "--store", store, "--results", tmp_path, "--fps", "120", *samples, *arguments
    )
    assert done.code == 0, done.stderr
    result = json.loads(done.stdout)
    details = result["blocks"][0]["rows"][0]["cells"]["120 fps"]["details"]
    assert {"KID", "precision", "recall", "density", "coverage"} < set(details)
    # Too few clips for a line through covariances that are not singular.
    assert "FID_∞" not in details
    assert result["definition"]["protocol"]["max_poses"] == 32


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("eval",), 2, "give --table NUMBER (2: clip-FID), --figure NUMBER or --calibrate; installed tables: nerm-"),
        (("eval", "--table", "2", "--figure", "5"), 2, "give --table NUMBER (2: clip-FID), --figure NUMBER"),
        (("eval", "--table", "77"), 2, "there is no table 77 of 'nerm'"),
        (("eval", "--table", "2", "--fps", "20,x"), 2, "--fps x"),
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


AT_20_FPS = ("--fps", "20", "--clips", "96", "--replications", "2", "--evaluator", "kinematic", "--sizes", "16:24")


def frozen(folder: Path) -> Path:
    """Two motions that do not move at all: every feature of theirs is constant."""
    folder.mkdir()
    for name in ("a", "b"):
        np.save(folder / f"{name}.npy", np.repeat(published.motions()[0][:1], 60, axis=0))
    return folder


def test_every_published_layout_gets_its_row(motionkit, store, tmp_path):
    found = np.concatenate(published.vectors())
    mean, std = found.mean(axis=0), np.maximum(found.std(axis=0), 0.01)
    folders = {
        "MDM": published.write_mdm(tmp_path / "mdm"),
        "MDM, exported": published.write_mdm(tmp_path / "mdm-npz", export=True) / "results.npz",
        "MLD": published.write_mld_demo(tmp_path / "mld"),
        "T2M-GPT": published.write_t2m_gpt(tmp_path / "gpt"),
        "T2M-GPT, vectors": published.write_t2m_gpt_vectors(tmp_path / "gpt-vectors", mean, std),
        "MoMask": published.write_momask(tmp_path / "momask"),
        "BVH": tmp_path / "momask" / "animations",
        "KIT": published.write_kit_joints(tmp_path / "kit", 0.0017),
        "frozen": frozen(tmp_path / "frozen"),
    }
    samples = [part for name, path in folders.items() for part in ("--samples", f"{name}={path}")]
    np.save(tmp_path / "gpt" / "000009_pred.npy", np.full((1, 50, 22, 3), np.nan, np.float32))
    arguments = ("--store", store, "--results", tmp_path / "results", "--samples-fps", 20, "--json", *AT_20_FPS)
    done = motionkit("eval", "--table", 2, *samples, *arguments)
    assert (done.code, done.stderr.count("left out of")) == (1, 1), done.stderr
    result = json.loads(done.stdout)
    rows = {row["name"]: row for row in result["blocks"][0]["rows"]}
    values = {name: rows[name]["cells"]["20 fps"]["value"] for name in folders}
    # The same motions give the same row, however they are written.
    for name in ("MDM, exported", "MLD", "T2M-GPT"):
        assert values[name] == pytest.approx(values["MDM"], rel=1e-9)
    assert values["T2M-GPT, vectors"] == pytest.approx(values["MDM"], rel=0.2)
    assert np.isfinite(list(values.values())).all()
    assert values["frozen"] > values["MDM"]
    assert "6 motions at 20 fps" in rows["MoMask"]["note"]
    assert "1 of 7 motions left out (1 nan)" in rows["T2M-GPT"]["note"]
    assert "6 motions at 12.5 fps" in rows["KIT"]["note"]
    assert {"kid", "precision"} <= {key.lower() for key in rows["MDM"]["cells"]["20 fps"]["details"]}
    assert len(result["provenance"]["samples"]) == len(folders)


def test_broken_samples_are_left_out_and_cost_the_exit_code(motionkit, store, tmp_path):
    folder = published.write_t2m_gpt(tmp_path / "gpt")
    np.save(folder / "000009_pred.npy", np.full((1, 50, 22, 3), np.nan, np.float32))
    (folder / "000010_pred.npy").write_bytes(b"half a file")
    np.save(folder / "000011_pred.npy", 1000 * published.motions()[0])
    arguments = ("--store", store, "--results", tmp_path / "results", "--samples-fps", 20, *AT_20_FPS)
    done = motionkit("eval", "--table", 2, "--samples", f"mine={folder}", *arguments)
    assert done.code == 1
    assert "| mine" in done.stdout
    assert "3 of 9 motions left out (1 nan, 1 not-what-it-says, 1 body-size)" in done.stdout
    # They are named before anything is computed.
    first = done.stderr.splitlines()[:3]
    assert all(line.startswith("left out of 'mine': ") for line in first)
    names = ("000009_pred.npy, frame 0: nan", "000010_pred.npy", "000011_pred.npy")
    assert all(name in line for name, line in zip(names, first, strict=True))
    assert "built without broken samples (3 of 'mine')" in done.stderr
    # Without a run, what trains models is none of the user's business.
    assert "no run" not in done.stdout + done.stderr and "motionkit train" not in done.stdout + done.stderr
    notes = [line for line in done.stdout.splitlines() if line.startswith("- ")]
    assert len(notes) == len(set(notes)) and sum("motions left out" in line for line in notes) == 1
