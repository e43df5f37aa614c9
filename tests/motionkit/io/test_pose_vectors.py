"""Pose vectors of four conventions in files of their own, against encoders that were written apart from the readers."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core import kinematics
from motionkit.core.skeletons.mapping import map_joints
from motionkit.features import humanml3d
from motionkit.io.humanml3d import KIT
from tests.helpers.refusal import refusal
from tests.helpers.vector_samples import interhuman_rows, motionstreamer_rows, walk


@pytest.fixture(scope="module")
def motion() -> mk.Motion:
    return walk()


def _read(path: Path, rows: np.ndarray, **options: object) -> mk.Motion:
    np.save(path, rows)
    return mk.read(path, **options)


@pytest.mark.parametrize(("layout", "fps"), [("smpl22", 20), ("kit21", Fraction(25, 2))])
def test_humanml3d_and_kit(tmp_path: Path, motion: mk.Motion, layout: str, fps: Fraction) -> None:
    unit = KIT.unit_metres if layout == "kit21" else 1.0
    own = humanml3d.facing_forward(humanml3d.at_origin(map_joints(motion, layout) / np.float32(unit)), layout)
    rows = humanml3d.vectors(own, layout)
    found = _read(tmp_path / "walk.npy", rows)
    assert found.fps == fps and found.provenance.source_format in ("humanml3d", "kit")
    np.testing.assert_allclose(found.joint_positions, own[:-1] * unit, atol=2e-3)
    np.testing.assert_array_equal(_read(tmp_path / "one.npy", rows[None]).joint_positions, found.joint_positions)
    (tmp_path / "motions.json").write_text('{"fps": 60}')
    assert mk.read(tmp_path / "walk.npy").fps == 60
    assert mk.read(tmp_path / "walk.npy", fps=24).fps == 24


def test_interhuman(tmp_path: Path, motion: mk.Motion) -> None:
    other = walk(seed=5)
    rows, others = interhuman_rows(motion), interhuman_rows(other)
    assert rows.shape[1] == 262
    alone = _read(tmp_path / "alone.npy", rows)
    assert alone.fps == 30
    np.testing.assert_array_equal(alone.joint_positions, motion.joint_positions[:-1])
    for name, both in (("stacked", np.stack((rows, others), axis=1)), ("flat", np.hstack((rows, others)))):
        np.save(tmp_path / f"{name}.npy", both)
        first, second = mk.read_all(tmp_path / f"{name}.npy")
        assert first.sequence_id.endswith(f"{name}/person1") and second.sequence_id.endswith(f"{name}/person2")
        np.testing.assert_array_equal(first.joint_positions, motion.joint_positions[:-1])
        np.testing.assert_array_equal(second.joint_positions, other.joint_positions[:-1])
    own = np.zeros((len(rows), 492), np.float32)
    own[:, :66] = motion.joint_positions[:-1][..., [0, 2, 1]].reshape(-1, 66)
    own[:, 1:66:3] *= -1
    np.testing.assert_array_equal(_read(tmp_path / "1.npy", own).joint_positions, alone.joint_positions)


def test_motionstreamer(tmp_path: Path, motion: mk.Motion) -> None:
    found = _read(tmp_path / "walk.npy", motionstreamer_rows(motion))
    assert found.fps == 30
    # Neither where it starts nor which way is in the numbers.
    x, _, z = kinematics.quaternion_to_matrix(motion.local_rotations[0, 0])[:, 2]
    half = -np.arctan2(x, z) / 2
    turn = np.array([np.cos(half), 0, np.sin(half), 0])
    start = motion.joint_positions[0, 0] * [1, 0, 1]
    np.testing.assert_allclose(
        found.joint_positions, kinematics.quaternion_rotate(turn, motion.joint_positions - start), atol=1e-5
    )
    np.testing.assert_allclose(
        abs(np.sum(found.local_rotations[:, 1:] * motion.local_rotations[:, 1:], -1)), 1, atol=1e-5
    )
    again = kinematics.forward_kinematics(found.local_rotations, found.root_translation, found.skeleton)
    np.testing.assert_allclose(again, found.joint_positions, atol=1e-5)


@pytest.mark.parametrize(
    ("width", "change", "reason"),
    [
        *((width, lambda rows: np.random.default_rng(0).normal(size=rows.shape), "unit") for width in (263, 262, 272)),
        *((width, lambda rows: np.where(rows == rows[3], np.nan, rows), "nan") for width in (263, 262)),
        (272, lambda rows: np.where(np.arange(272) >= 140, 0.0, rows), "range"),
        (272, lambda rows: rows[:0], "no-frames"),
        (263, lambda rows: np.full(rows.shape, 1e7), "range"),
        (263, lambda rows: rows.astype("U8"), "not-a-number"),
    ],
)
def test_what_is_wrong_is_reported(tmp_path: Path, motion: mk.Motion, width: int, change, reason: str) -> None:
    rows = {
        263: lambda: humanml3d.vectors(motion.joint_positions, "smpl22"),
        262: lambda: interhuman_rows(motion),
        272: lambda: motionstreamer_rows(motion),
    }[width]()
    assert rows.shape[1] == width
    assert refusal(_read, tmp_path / "bad.npy", change(rows)).reason == reason
