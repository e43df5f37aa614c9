"""`motionkit eval --table 2 --samples`: each published layout gets its row; a broken one costs the exit code."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.motion import Caption, Motion
from motionkit.fields.motion_field import to_motion
from motionkit.store.writer import StoreWriter
from tests.helpers import published_layouts as published
from tests.helpers.analytic import ACTIONS, analytic_motion

SMALL = ("--fps", "20", "--clips", "96", "--replications", "2", "--evaluator", "kinematic", "--sizes", "16:24")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("samples") / "store"
    with StoreWriter.create(path) as writer:
        for index in range(8):
            field = analytic_motion(list(ACTIONS)[index % len(ACTIONS)], 4.0, index)
            motion = to_motion(field, Fraction(30))
            writer.add(
                Motion(
                    motion.joint_positions,
                    motion.skeleton,
                    motion.timegrid,
                    captions=(Caption("a person moves"),),
                    split="test" if index % 2 else "train",
                    sequence_id=f"take-{index}",
                )
            )
    return path


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
    arguments = ("--store", store, "--results", tmp_path / "results", "--samples-fps", 20, "--json", *SMALL)
    done = motionkit("eval", "--table", 2, *samples, *arguments, "--allow-broken")
    assert (done.code, done.stderr.count("left out")) == (0, 1), done.stderr
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
    note = result["blocks"][0]["note"]
    assert "At 20 fps these have no more motions than there are features (" in note
    assert "MDM (6)" in note
    assert {"kid", "precision"} <= {key.lower() for key in rows["MDM"]["cells"]["20 fps"]["details"]}
    assert len(result["provenance"]["samples"]) == len(folders)


def test_broken_samples_are_left_out_and_cost_the_exit_code(motionkit, store, tmp_path):
    folder = published.write_t2m_gpt(tmp_path / "gpt")
    np.save(folder / "000009_pred.npy", np.full((1, 50, 22, 3), np.nan, np.float32))
    (folder / "000010_pred.npy").write_bytes(b"half a file")
    np.save(folder / "000011_pred.npy", 1000 * published.motions()[0])
    arguments = ("--store", store, "--results", tmp_path / "results", "--samples-fps", 20, *SMALL)
    done = motionkit("eval", "--table", 2, "--samples", f"mine={folder}", *arguments)
    assert done.code == 1
    assert "| mine" in done.stdout
    assert "3 of 9 motions left out (1 nan, 1 not-what-it-says, 1 body-size)" in done.stdout
    # They are named before anything is computed.
    first = done.stderr.splitlines()[:3]
    assert all(line.startswith("left out of 'mine': ") for line in first)
    names = ("000009_pred.npy, frame 0: nan", "000010_pred.npy", "000011_pred.npy")
    assert all(name in line for name, line in zip(names, first, strict=True))
    assert "built without broken samples (3 of 'mine'); --allow-broken accepts that" in done.stderr
    # Without a run, what trains models is none of the user's business.
    assert done.stderr.count("there is no run 'runs/nano': only --samples have rows") == 1
    assert "motionkit train" not in done.stdout + done.stderr
