"""Markers as C3D (beside ezc3d) and TRC: joints, gaps, units, axes, and what is refused."""

import re
import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest

import motionkit as mk
from motionkit.core.skeletons.mapping import map_joints
from motionkit.io.markers import numbers_of, parse_c3d, read_c3d
from motionkit.io.registry import ReadOptions
from tests.helpers.every_format import TRC_JOINTS, c3d_bytes, trc_text
from tests.helpers.refusal import refusal
from tests.helpers.vector_samples import walk

LABELS = ("LASI", "RASI", "SACR")


def points(num_frames: int = 30, num_points: int = 3) -> np.ndarray:
    generator = np.random.default_rng(7)
    return np.cumsum(generator.normal(size=(num_frames, num_points, 3)), axis=0) + np.array([300.0, 200.0, 900.0])


def write(path: Path, positions: np.ndarray, labels: tuple[str, ...] = LABELS, **parameters: Any) -> Path:
    """A file by ezc3d; `parameters` are of POINT, None leaves one out."""
    file = ezc3d.c3d()
    values = {"RATE": [120.0], "LABELS": list(labels), "UNITS": ["mm"], "X_SCREEN": ["+X"], "Y_SCREEN": ["+Z"]}
    for name, value in (values | parameters).items():
        if value is not None:
            file.add_parameter("POINT", name, value)
    data = np.ones((4, positions.shape[1], len(positions)))
    data[:3] = positions.transpose(2, 1, 0)
    file["data"]["points"] = data
    file.write(str(path))
    return path


def test_what_ezc3d_writes_is_read_in_metres_and_y_up(tmp_path: Path) -> None:
    positions = points()
    motion = read_c3d(write(tmp_path / "take.c3d", positions))
    assert motion.fps == 120 and motion.num_frames == 30 and motion.local_rotations is None
    assert motion.skeleton.joint_names == LABELS and motion.skeleton.parents == (-1, 0, 0)
    expected = np.stack((positions[..., 0], positions[..., 2], -positions[..., 1]), axis=-1) / 1000
    assert np.allclose(motion.joint_positions, expected, atol=1e-6)
    assert motion.provenance.stated_fps == "POINT:RATE 120"
    assert len(motion.provenance.operations) == 2


@pytest.mark.parametrize("scale", [-1.0, 0.05])
@pytest.mark.parametrize("processor", [84, 85, 86])
def test_every_number_format_is_read_as_ezc3d_reads_it(tmp_path: Path, processor: int, scale: float) -> None:
    positions = points() / 10
    path = tmp_path / "take.c3d"
    path.write_bytes(c3d_bytes(positions, processor, scale, analog=2))
    file = parse_c3d(path.read_bytes(), path)
    assert np.allclose(file.points[..., :3], positions, atol=1e-4 if scale < 0 else 0.026)
    assert numbers_of(file.parameters, "POINT:RATE") == (100.0,)
    if processor == 84:  # ezc3d 1.7.2 knows no MIPS and reads our DEC header as another
        path.write_bytes(c3d_bytes(positions, processor, scale))
        reference = ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0)
        assert np.allclose(file.points[..., :3], reference, atol=1e-4)


@pytest.mark.parametrize("up", ["+X", "-X", "+Y", "-Y", "+Z", "-Z"])
def test_the_axis_that_points_up_on_the_screen_becomes_y(tmp_path: Path, up: str) -> None:
    axis, sign = "XYZ".index(up[1]), 1.0 if up[0] == "+" else -1.0
    positions = np.zeros((5, 3, 3))
    positions[:, 0, axis] = 1500.0 * sign
    positions[:, 1, (axis + 1) % 3] = 300.0
    positions[:, 2, (axis + 2) % 3] = 200.0
    motion = read_c3d(write(tmp_path / "take.c3d", positions, Y_SCREEN=[up]))
    assert np.allclose(motion.joint_positions[:, 0], (0.0, 1.5, 0.0))
    assert np.isclose(np.linalg.det(motion.joint_positions[0]), np.linalg.det(positions[0]) / 1e9)


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("MM", 0.001), ("in", 0.0254), (None, 0.001)])
def test_units(tmp_path: Path, unit: str | None, metres: float) -> None:
    path = write(tmp_path / "take.c3d", points(), UNITS=None if unit is None else [unit], Y_SCREEN=["+Y"])
    assert np.allclose(read_c3d(path).joint_positions, points() * metres, rtol=1e-5)
    given_unit = read_c3d(path, ReadOptions(unit_metres=0.5, fps=Fraction(50)))
    assert given_unit.fps == 50 and given_unit.provenance.operations[0] == "framerate set to 50; the file says 120"
    assert np.allclose(given_unit.joint_positions, points() * 0.5, rtol=1e-5)


def test_short_gaps_are_filled_and_markers_with_long_ones_are_dropped(tmp_path: Path) -> None:
    positions = points(60, 5)
    positions[10:20, 1] = np.nan  # 10 frames of 120 per second: filled
    positions[:12, 2] = np.nan  # the beginning, held
    positions[30:43, 3] = 0.0  # 13 frames: too long
    positions[:, 4] = np.nan
    motion = read_c3d(write(tmp_path / "take.c3d", positions, ("A", "B", "C", "D", "E"), Y_SCREEN=["+Y"], UNITS=["m"]))
    assert motion.skeleton.joint_names == ("A", "B", "C")
    found = motion.joint_positions.astype(np.float64)
    weights = np.arange(1, 11)[:, None] / 11
    assert np.allclose(found[10:20, 1], (1 - weights) * positions[9, 1] + weights * positions[20, 1], rtol=1e-5)
    assert np.allclose(found[:12, 2], positions[12, 2], rtol=1e-5)
    assert np.allclose(found[:, 0], positions[:, 0], rtol=1e-5)


def test_what_is_no_labelled_marker_is_left_out(tmp_path: Path) -> None:
    labels = ("Anna:LASI", "*12", "Anna:LHipAngles", "Anna:LASI")
    path = write(tmp_path / "take.c3d", points(30, 4), labels, ANGLES=["Anna:LHipAngles"])
    motion = read_c3d(path)
    assert motion.skeleton.joint_names == ("LASI", "LASI_2")
    numbered = read_c3d(write(tmp_path / "other.c3d", points(), ("*0", "*1", "*2")))
    assert numbered.skeleton.joint_names == ("marker_1", "marker_2", "marker_3")


def test_a_take_longer_than_the_header_can_say(tmp_path: Path) -> None:
    positions = np.repeat(points(1), 70_000, axis=0)
    assert refusal(read_c3d, write(tmp_path / "take.c3d", positions)).reason == "frame-count"
    file = ezc3d.c3d(str(write(tmp_path / "other.c3d", positions[:3])))
    file.add_parameter("TRIAL", "ACTUAL_START_FIELD", [1, 0])
    file.add_parameter("TRIAL", "ACTUAL_END_FIELD", [70_000 - 65_536, 1])
    data = np.ones((4, 3, 70_000))
    data[:3] = positions.transpose(2, 1, 0)
    file["data"]["points"] = data
    file["data"]["meta_points"] = {
        "residuals": np.zeros((1, 3, 70_000)),
        "camera_masks": np.zeros((7, 3, 70_000), bool),
    }
    file.write(str(tmp_path / "long.c3d"))
    assert read_c3d(tmp_path / "long.c3d").num_frames == 70_000


def damaged(content: bytes, at: int, *values: int) -> bytes:
    return content[:at] + bytes(values) + content[at + len(values) :]


GOOD = c3d_bytes(points(), 84, -1.0)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"HIERARCHY\n" + b" " * 600, "not-what-it-says"),
        (b"\x02\x50", "truncated"),
        (GOOD[:-1], "truncated"),
        (damaged(GOOD, 0, 200), "truncated"),
        (damaged(GOOD, 2, 255, 255), "truncated"),
        (damaged(GOOD, 515, 83), "parameters"),
        (damaged(GOOD, 2, 0, 0), "no-markers"),
        (damaged(GOOD, 8, 0, 0), "no-frames"),
        (GOOD.replace(struct.pack("<f", 100.0), struct.pack("<f", np.nan)), "frame-time"),
        (c3d_bytes(np.full((30, 3, 3), np.nan), 84, -1.0), "gaps"),
        (GOOD.replace(b"cm", b"xx"), "unit"),
        (c3d_bytes(points() * 1e6, 84, -1.0), "range"),
    ],
)
def test_bad_c3d_files_are_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "take.c3d").write_bytes(content)
    assert refusal(read_c3d, tmp_path / "take.c3d").reason == reason


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


def test_commas_between_columns_or_in_numbers(tmp_path: Path) -> None:
    text = trc_text(_points())
    plain = _read(tmp_path, text).joint_positions
    head, numbers = text.splitlines()[:5], text.splitlines()[5:]
    for changed in (text.replace("\t", ","), "\n".join([*head, *(line.replace(".", ",") for line in numbers)])):
        np.testing.assert_array_equal(_read(tmp_path, changed).joint_positions, plain)


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
def test_bad_trc_files_are_refused(tmp_path: Path, change, reason: str) -> None:
    text = trc_text(_points() - np.float32(5.0))
    changed = change(text)
    assert changed != text
    assert refusal(_read, tmp_path, changed).reason == reason
