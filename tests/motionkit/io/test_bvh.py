"""BVH files as they are, good and bad: bodies, framerates, what is recovered, and what is refused with which reason."""

import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.skeletons.mapping import joint_map
from motionkit.io.bvh import T_POSE_DROPPED, read_bvh, read_document
from motionkit.io.registry import ReadOptions
from tests.helpers.bones import check_rotations
from tests.helpers.format_samples import NUM_BVH_CHANNELS, bvh_hierarchy, bvh_text
from tests.helpers.refusal import refusal


def test_positions_rotations_and_framerate(tmp_path: Path) -> None:
    path = tmp_path / "walk.bvh"
    path.write_text(bvh_text())
    motion = read_bvh(path)
    assert motion.fps == Fraction(30) and motion.num_frames == 4
    assert motion.provenance.stated_fps == "Frame Time: 0.0333333"
    hand, elbow = motion.skeleton.index("LeftHand"), motion.skeleton.index("LeftForeArm")
    assert np.allclose(motion.joint_positions[3, 0], (0, 0.95, 0.06))
    assert np.allclose(motion.joint_positions[0, hand], (0.72, 1.42, 0.0), atol=1e-6)
    bend = np.radians(30)
    forearm = motion.joint_positions[3, hand] - motion.joint_positions[3, elbow]
    assert np.allclose(forearm, (0.26 * np.cos(bend), 0.26 * np.sin(bend), 0.0), atol=1e-6)
    check_rotations(motion, 1e-6)


@pytest.mark.parametrize("pattern", ["cmu/bvh/*.bvh", "cmu/bvh-converted/*.bvh", "mixed-bvh/*/*.bvh"])
def test_every_real_file_is_a_metre_sized_upright_body(captures: Path, pattern: str) -> None:
    for path in sorted(captures.glob(pattern)):
        motion = read_bvh(path)
        (head, *_) = (joint for joint, name in enumerate(motion.skeleton.joint_names) if name.lower().endswith("head"))
        assert 0.9 < np.median(motion.joint_positions[:, head, 1]) < 2.2, path.name


def test_the_t_pose_of_the_cmu_conversions_is_dropped_and_no_other_frame(captures: Path) -> None:
    for folder, dropped, family in (("bvh", True, "cgspeed-motionbuilder"), ("bvh-converted", False, "cmu")):
        for path in sorted((captures / "cmu" / folder).glob("*.bvh")):
            motion = read_bvh(path)
            assert (T_POSE_DROPPED in motion.provenance.operations) == dropped, path.name
            assert joint_map(motion.skeleton, "smpl22").family == family


TEXT = bvh_text()
LINES = TEXT.splitlines()
FIRST_ROW = next(number for number, line in enumerate(LINES) if line.startswith("Frame Time")) + 1  # 0-based


def with_line(number: int, line: str) -> str:
    return "\n".join([*LINES[:number], line, *LINES[number + 1 :]]) + "\n"


def row(*values: str) -> str:
    return " ".join([*values, *["0"] * (NUM_BVH_CHANNELS - len(values))])


BAD: dict[str, tuple[str | bytes, str, int | None, int | None]] = {
    # name: (content, reason, 1-based line, 0-based frame)
    "an AMC file": (":FULLY-SPECIFIED\n1\nroot 0\n", "not-what-it-says", 1, None),
    "cut in the hierarchy": ("\n".join(LINES[:20]), "hierarchy", 20, None),
    "cut before MOTION": (bvh_hierarchy(), "truncated", bvh_hierarchy().count("\n") + 1, None),
    "cut in a line": (TEXT[:-20], "truncated", len(LINES), 3),
    "one number short": (with_line(FIRST_ROW + 1, row()[:-2]), "channel-count", FIRST_ROW + 2, 1),
    "a line more": (TEXT + row() + "\n", "frame-count", len(LINES) + 1, None),
    "inf": (with_line(FIRST_ROW + 2, row("0", "-inf")), "nan", FIRST_ROW + 3, 2),
    "an underscore": (with_line(FIRST_ROW, row("1_0")), "not-a-number", FIRST_ROW + 1, 0),
    "beyond reason": (with_line(FIRST_ROW, row("1e300")), "range", FIRST_ROW + 1, 0),
    "zero frame time": (bvh_text(frame_time="0"), "frame-time", FIRST_ROW, None),
    "missing frame time": ("\n".join([*LINES[: FIRST_ROW - 1], *LINES[FIRST_ROW:]]), "frame-time", None, None),
    "missing frame count": ("\n".join([*LINES[: FIRST_ROW - 2], *LINES[FIRST_ROW:]]), "frame-count", None, None),
    "no frames": (bvh_text(rows=[]), "no-frames", None, None),
    "more frames than bytes": (TEXT.replace("Frames: 4", "Frames: 99999999999"), "truncated", len(LINES), 4),
    "a broken name": (TEXT.encode().replace(b"LeftArm", b"Left\xffrm"), "encoding", None, None),
    "a channel count of 5,000 digits": (TEXT.replace("CHANNELS 6", f"CHANNELS {'6' * 5000}"), "channels", 5, None),
    "a repeated channel": (TEXT.replace("Yposition", "Xposition", 1), "channels", 5, None),
    "a wordy offset": (TEXT.replace("OFFSET 0 95 0", "OFFSET 0 x 0"), "not-a-number", 4, None),
    "a brace too many": (TEXT.replace("MOTION", "}\nMOTION"), "hierarchy", None, None),
    "no body of any size": (TEXT.replace("0 -42 0", "0 -180 0"), "unit", None, None),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_explained_in_one_line(tmp_path: Path, name: str) -> None:
    content, reason, line, frame = BAD[name]
    path = tmp_path / "bad.bvh"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    error = refusal(read_bvh, path)
    assert str(path) in str(error)
    assert (error.reason, error.line if line else None, error.frame) == (reason, line, frame)


@pytest.mark.parametrize(
    "variant",
    [
        "\ufeff" + TEXT,
        TEXT.replace(" ", "  ").replace("\n", "  \n"),
        TEXT.replace(" ", "\t").replace("0.0333333", ".0333333"),
        TEXT.replace("\n{", " {").replace("OFFSET 0 95 0", "OFFSET 0.0 9.5e+01 0"),
        # Each empty line was once a count of all lines before it: minutes.
        TEXT.replace("Frames: 4", "\n" * 200_000 + "Frames: 4\n" + "\n" * 200_000),
        TEXT.rstrip("\n"),
        TEXT.replace("Zrotation", "ZROTATION").replace("End Site", "End site"),
    ],
)
def test_the_ways_in_which_good_files_differ(tmp_path: Path, variant: str) -> None:
    path = tmp_path / "good.bvh"
    path.write_bytes(variant.encode())
    motion = read_bvh(path)
    assert motion.num_frames == 4 and motion.fps == 30
    assert motion.joint_positions[3, 0].tolist() == pytest.approx([0, 0.95, 0.06])


def test_names_with_spaces_and_colons_and_repeated_ones(tmp_path: Path) -> None:
    text = TEXT.replace("LeftArm", "rig:Left Arm").replace("LeftHand", "Hand").replace("RightHand", "Hand")
    (tmp_path / "a.bvh").write_text(text)
    motion = read_bvh(tmp_path / "a.bvh", ReadOptions(unit_metres=0.01))
    assert {"rig:Left Arm", "Hand", "Hand_2"} <= set(motion.skeleton.joint_names)


@pytest.mark.parametrize("moves", [0.0, 30.0])
def test_bones_that_move_leave_positions_only(tmp_path: Path, moves: float) -> None:
    table = np.zeros((3, NUM_BVH_CHANNELS))
    table[:, 7], table[2, 7] = 10.0, 10.0 + moves
    rotations, places = "CHANNELS 3 Zrotation Xrotation Yrotation", "CHANNELS 3 Xposition Yposition Zposition"
    (tmp_path / "a.bvh").write_text(bvh_text(table.tolist()).replace(rotations, places, 1))
    motion = read_bvh(tmp_path / "a.bvh", ReadOptions(unit_metres=0.01))
    assert (motion.local_rotations is None) == (moves > 0)
    assert motion.joint_positions[2, 1].tolist() == pytest.approx([0, 0.1 + 0.01 * moves, 0])


def rows(num_frames: int) -> np.ndarray:
    table = np.random.default_rng(3).normal(0, 30, (num_frames, NUM_BVH_CHANNELS)).round(3)
    table[:, 1] = 95
    return table


def t_pose_first(num_frames: int) -> str:
    table = rows(num_frames)
    table[0, 3:] = 0
    table[1, :3] = table[0, :3]
    return bvh_text(table.tolist())


def along_z(text: str) -> str:
    return re.sub(r"OFFSET (\S+) (\S+) (\S+)", r"OFFSET \1 \3 \2", text)


def carried(text: str) -> str:
    """A root that only carries the hips."""
    hips, rest = text.split("MOTION")
    frames = [f"1 2 3 0 10 20 {line}" for line in rest.splitlines()[3:]]
    channels = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    root = f"HIERARCHY\nROOT Carrier\n{{\nOFFSET 0 0 0\n{channels}\n"
    inner = hips.replace("HIERARCHY\nROOT", "JOINT")
    return f"{root}{inner}}}\nMOTION" + "\n".join([*rest.splitlines()[:3], *frames]) + "\n"


TAKES = {
    "plain": bvh_text(rows(50).tolist()),
    "a T-pose first": t_pose_first(50),
    "one frame": bvh_text(rows(1).tolist()),
    "blank lines": bvh_text(rows(50).tolist()).replace("\n", "\n\n"),
    "old line ends": bvh_text(rows(50).tolist()).replace("\n", "\r"),
    "along z": along_z(bvh_text(rows(50).tolist())),
    "a root that carries another": carried(bvh_text(rows(50).tolist())),
}


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r", " \n\n"])
def test_line_ends_of_all_kinds(tmp_path: Path, ending: str) -> None:
    table = rows(9)
    (tmp_path / "a.bvh").write_bytes((bvh_text(table.tolist()).rstrip("\n") + "\n\n").replace("\n", ending).encode())
    document = read_document(tmp_path / "a.bvh")
    np.testing.assert_allclose(document.table, table, rtol=1e-5)
    assert document.lines == [line.encode() for line in bvh_text(table.tolist()).splitlines()[-9:]]
