"""TRC tables of known motion: joints by their names, gaps, units, axes; and what is wrong with some."""

import re
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core.skeletons.mapping import map_joints
from tests.helpers.every_format import TRC_JOINTS, trc_text
from tests.helpers.refusal import refusal
from tests.helpers.vector_samples import walk

FRAMES = 30


def _points() -> np.ndarray:
    return walk().joint_positions[:FRAMES, list(TRC_JOINTS.values())]


def _read(folder: Path, text: str, **options: object) -> mk.Motion:
    (folder / "walk.trc").write_text(text)
    return mk.read(folder / "walk.trc", **options)


def test_joints_by_their_names(tmp_path: Path) -> None:
    points = _points()
    found = _read(tmp_path, trc_text(points))
    assert found.fps == 60
    np.testing.assert_allclose(found.joint_positions, points, atol=1e-6)
    body = map_joints(found, "smpl22")
    truth = walk().joint_positions[:FRAMES]
    np.testing.assert_allclose(body[:, [1, 4, 7, 17, 19]], truth[:, [1, 4, 7, 17, 19]], atol=1e-6)
    assert np.linalg.norm(body - truth, axis=-1).mean() < 0.06
    z_up = points[..., [0, 2, 1]] * np.array([1, -1, 1], np.float32)
    np.testing.assert_allclose(_read(tmp_path, trc_text(z_up)).joint_positions, points, atol=1e-6)


def test_markers_that_are_no_joints_keep_their_axes(tmp_path: Path) -> None:
    names = [f"M{number}" for number in range(len(TRC_JOINTS))]
    found = _read(tmp_path, trc_text(_points(), names=names), fps=100)
    assert found.fps == 100 and found.skeleton.joint_names == tuple(names)
    np.testing.assert_allclose(found.joint_positions, _points(), atol=1e-6)


def test_gaps_are_filled_or_cost_the_marker(tmp_path: Path) -> None:
    points = _points()
    points[:20, 3], points[5:7, 4] = 0.0, np.nan
    text = trc_text(points)
    assert "\t\t\t" in text.splitlines()[11]
    found = _read(tmp_path, text)
    assert found.skeleton.joint_names == tuple(name for place, name in enumerate(TRC_JOINTS) if place != 3)
    filled = points[4, 4] + (points[7, 4] - points[4, 4]) / 3
    np.testing.assert_allclose(found.joint_positions[5, 3], filled, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda text: text.replace("PathFileType", "Path"), "not-what-it-says"),
        (lambda text: "\n".join(text.splitlines()[:5]), "no-frames"),
        (lambda text: "\n".join(text.splitlines()[:-4]), "truncated"),
        (lambda text: text.replace("\t60\t30\t16", "\t60\t30\t9"), "channel-count"),
        (lambda text: text.replace("mm", "furlong"), "unit"),
        (lambda text: text.replace("60\t60\t30", "24\t60\t30"), "frame-time"),
        (lambda text: text.replace("\t-", "\tx", 1), "not-a-number"),
        (lambda text: re.sub(r"\t-[0-9.]+", "\t1e30", text, count=1), "range"),
    ],
)
def test_what_is_wrong_is_reported(tmp_path: Path, change, reason: str) -> None:
    text = trc_text(_points() - np.float32(5.0))
    changed = change(text)
    assert changed != text
    assert refusal(_read, tmp_path, changed).reason == reason
