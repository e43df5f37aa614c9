"""Files out of a store and in again."""

import csv
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.motion import Motion, Provenance
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter


@pytest.mark.parametrize(
    ("name", "fields", "arrays", "metres"),
    [
        ("npz", ("timegrid", "skeleton"), ("joint_positions", "local_rotations", "root_translation"), 0.0),
        ("bvh", ("fps",), (), 2e-4),
        ("csv", ("timegrid",), ("joint_positions",), 0.0),
    ],
)
def test_what_comes_back(store, export_as, ingest_again, name, fields, arrays, metres):
    report = export_as(store, name)
    assert (report.num_sequences, report.num_files) == (3, 4)
    for before, after in zip(store.read_many(range(3)), ingest_again(report.folder), strict=True):
        for each in (*fields, "captions", "action", "style", "split"):
            assert getattr(after, each) == getattr(before, each), each
        for each in ("source", "subset", "licence", "subject", "stated_fps"):
            assert getattr(after.provenance, each) == getattr(before.provenance, each), each
        for each in arrays:
            np.testing.assert_array_equal(getattr(after, each), getattr(before, each))
        order = [after.skeleton.index(joint) for joint in before.skeleton.joint_names]
        np.testing.assert_allclose(after.joint_positions[:, order], before.joint_positions, atol=metres)


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
