"""Files out of a store and in again."""

import csv
from dataclasses import replace
from fractions import Fraction

import numpy as np

from motionkit.core.motion import Motion, Provenance
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter


def test_npz_loses_nothing(store, export_as, ingest_again):
    report = export_as(store, "npz")
    assert (report.num_sequences, report.num_files) == (3, 4)
    for before, after in zip(store.read_many(range(3)), ingest_again(report.folder), strict=True):
        for name in ("timegrid", "captions", "action", "style", "split", "skeleton"):
            assert getattr(after, name) == getattr(before, name), name
        for name in ("source", "subset", "licence", "subject", "stated_fps", "operations"):
            assert getattr(after.provenance, name) == getattr(before.provenance, name), name
        for name in ("joint_positions", "local_rotations", "root_translation"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def test_bvh_keeps_the_exact_framerate_and_the_words(store, export_as, ingest_again):
    report = export_as(store, "bvh")
    for before, after in zip(store.read_many(range(3)), ingest_again(report.folder), strict=True):
        for name in ("fps", "captions", "action", "style", "split"):
            assert getattr(after, name) == getattr(before, name), name
        order = [after.skeleton.index(joint) for joint in before.skeleton.joint_names]
        np.testing.assert_allclose(after.joint_positions[:, order], before.joint_positions, atol=2e-4)


def test_csv_keeps_the_standard_joints_to_the_last_bit(store, export_as, ingest_again):
    report = export_as(store, "csv")
    for before, after in zip(store.read_many(range(3)), ingest_again(report.folder), strict=True):
        for name in ("timegrid", "captions", "action", "style", "split"):
            assert getattr(after, name) == getattr(before, name), name
        assert after.skeleton.joint_names == before.skeleton.joint_names
        np.testing.assert_array_equal(after.joint_positions, before.joint_positions)


def test_no_cell_is_a_formula(tmp_path, export_as, ingest_again):
    formula = "=cmd|'/c calc'!A1"
    with StoreWriter.create(tmp_path / "hostile") as writer:
        motion = Motion(
            np.zeros((4, 22, 3), np.float32), SMPL22, TimeGrid(Fraction(30), 4), sequence_id=f"{formula}/-x"
        )
        provenance = Provenance(source=formula, subset="@x", licence="+1", subject="\tx")
        writer.add(replace(motion, action=formula, style="-x", provenance=provenance))
    folder = export_as(Store.open(tmp_path / "hostile"), "npz").folder
    [row] = csv.DictReader((folder / "motions.csv").read_text(encoding="utf-8").splitlines())
    assert [cell for cell in row.values() if cell.startswith(("=", "+", "-", "@", "\t"))] == []
    assert (folder / row["file"]).is_file() and row["action"] == f"'{formula}"
    assert len(ingest_again(folder)) == 1
