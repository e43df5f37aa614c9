from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import FormatError
from motionkit.io.bvh.document import read_bvh
from motionkit.io.registry import ReadOptions
from tests.helpers.format_samples import NUM_BVH_CHANNELS, bvh_hierarchy, bvh_text

TEXT = bvh_text()
LINES = TEXT.splitlines()
FIRST_ROW = next(number for number, line in enumerate(LINES) if line.startswith("Frame Time")) + 1  # 0-based


def with_line(number: int, line: str) -> str:
    return "\n".join([*LINES[:number], line, *LINES[number + 1 :]]) + "\n"


def row(*values: str) -> str:
    return " ".join([*values, *["0"] * (NUM_BVH_CHANNELS - len(values))])


BAD: dict[str, tuple[str | bytes, str, int | None, int | None]] = {
    # name: (content, reason, 1-based line, 0-based frame)
    "empty": ("", "empty", None, None),
    "blank": (" \n\n", "empty", None, None),
    "an AMC file": (":FULLY-SPECIFIED\n1\nroot 0\n", "not-what-it-says", 1, None),
    "binary": (b"\x93NUMPY\x01\x00", "not-what-it-says", 1, None),
    "cut in the hierarchy": ("\n".join(LINES[:20]), "hierarchy", 20, None),
    "cut before MOTION": (bvh_hierarchy(), "truncated", bvh_hierarchy().count("\n") + 1, None),
    "cut after MOTION": (bvh_hierarchy() + "MOTION\nFrames: 2\n", "truncated", None, None),
    "cut in the frames": ("\n".join(LINES[:-1]) + "\n", "truncated", len(LINES) - 1, 3),
    "cut in a line": (TEXT[:-20], "truncated", len(LINES), 3),
    "one number short": (with_line(FIRST_ROW + 1, row()[:-2]), "channel-count", FIRST_ROW + 2, 1),
    "one number more": (with_line(FIRST_ROW + 1, row() + " 0"), "channel-count", FIRST_ROW + 2, 1),
    "a line more": (TEXT + row() + "\n", "frame-count", len(LINES) + 1, None),
    "nan": (with_line(FIRST_ROW + 2, row("0", "nan")), "nan", FIRST_ROW + 3, 2),
    "inf": (with_line(FIRST_ROW + 2, row("0", "-inf")), "nan", FIRST_ROW + 3, 2),
    "a word": (with_line(FIRST_ROW + 2, row("0", "abc")), "not-a-number", FIRST_ROW + 3, 2),
    "a decimal comma": (with_line(FIRST_ROW, row("0,5")), "not-a-number", FIRST_ROW + 1, 0),
    "an underscore": (with_line(FIRST_ROW, row("1_0")), "not-a-number", FIRST_ROW + 1, 0),
    "beyond reason": (with_line(FIRST_ROW, row("1e300")), "range", FIRST_ROW + 1, 0),
    "zero frame time": (bvh_text(frame_time="0"), "frame-time", FIRST_ROW, None),
    "negative frame time": (bvh_text(frame_time="-0.1"), "frame-time", FIRST_ROW, None),
    "huge frame time": (bvh_text(frame_time="1e9"), "frame-time", FIRST_ROW, None),
    "tiny frame time": (bvh_text(frame_time="1e-320"), "frame-time", FIRST_ROW, None),
    "nan frame time": (bvh_text(frame_time="nan"), "frame-time", FIRST_ROW, None),
    "wordy frame time": (bvh_text(frame_time="fast"), "frame-time", FIRST_ROW, None),
    "empty frame time": (bvh_text(frame_time=""), "frame-time", None, None),
    "missing frame time": ("\n".join([*LINES[: FIRST_ROW - 1], *LINES[FIRST_ROW:]]), "frame-time", None, None),
    "missing frame count": ("\n".join([*LINES[: FIRST_ROW - 2], *LINES[FIRST_ROW:]]), "frame-count", None, None),
    "no frames": (bvh_text(rows=[]), "no-frames", None, None),
    "a negative count": (TEXT.replace("Frames: 4", "Frames: -4"), "frame-count", None, None),
    "more frames than bytes": (TEXT.replace("Frames: 4", "Frames: 99999999999"), "truncated", len(LINES), 4),
    "a broken name": (TEXT.encode().replace(b"LeftArm", b"Left\xffrm"), "encoding", None, None),
    "an unknown channel": (TEXT.replace("Zrotation", "Wrotation", 1), "channels", 5, None),
    "a wrong channel count": (TEXT.replace("CHANNELS 6", "CHANNELS 5"), "channels", 5, None),
    "a huge channel count": (TEXT.replace("CHANNELS 6", "CHANNELS 999999999"), "channels", 5, None),
    "a channel count of 5,000 digits": (TEXT.replace("CHANNELS 6", f"CHANNELS {'6' * 5000}"), "channels", 5, None),
    "a repeated channel": (TEXT.replace("Yposition", "Xposition", 1), "channels", 5, None),
    "no offset": (TEXT.replace("\tOFFSET 0 95 0\n", ""), "hierarchy", None, None),
    "a short offset": (TEXT.replace("OFFSET 0 95 0", "OFFSET 0 95"), "hierarchy", 4, None),
    "a wordy offset": (TEXT.replace("OFFSET 0 95 0", "OFFSET 0 x 0"), "not-a-number", 4, None),
    "two roots": (TEXT.replace("MOTION", "ROOT Second\n{\n\tOFFSET 0 0 0\n}\nMOTION"), "hierarchy", None, None),
    "an unknown keyword": (TEXT.replace("OFFSET", "OFFSETT", 1), "hierarchy", 4, None),
    "a brace too many": (TEXT.replace("MOTION", "}\nMOTION"), "hierarchy", None, None),
    "no body of any size": (TEXT.replace("0 -42 0", "0 -180 0"), "unit", None, None),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_explained_in_one_line(tmp_path: Path, name: str) -> None:
    content, reason, line, frame = BAD[name]
    path = tmp_path / "bad.bvh"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(FormatError) as caught:
        read_bvh(path)
    error = caught.value
    assert error.reason == reason, error
    assert str(path) in str(error) and "\n" not in str(error)
    if line is not None:
        assert error.line == line, error
    assert error.frame == frame, error


def test_a_missing_file_is_explained(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as caught:
        read_bvh(tmp_path / "gone.bvh")
    assert caught.value.reason == "unreadable"


@pytest.mark.parametrize(
    "variant",
    [
        TEXT.replace("\n", "\r\n"),
        "\ufeff" + TEXT,
        TEXT.replace(" ", "\t"),
        TEXT.replace(" ", "  ").replace("\n", "  \n"),
        TEXT.replace("Frames: 4", "Frames:\t4").replace("Frame Time: ", "Frame Time:\t"),
        TEXT.replace("0.0333333", ".0333333"),
        TEXT.replace("\n{", " {"),
        TEXT.replace("OFFSET 0 95 0", "OFFSET 0.0 9.5e+01 0"),
        TEXT + "\n\n",
        TEXT.replace("\n0 ", "\n\n0 "),
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


def test_lines_are_counted_across_empty_ones(tmp_path: Path) -> None:
    path = tmp_path / "bad.bvh"
    path.write_text(TEXT.replace("Frames: 4", "\n\nFrames: 4\n").replace("0.0333333", "0.0333333\n\nx"))
    with pytest.raises(FormatError) as caught:
        read_bvh(path)
    assert caught.value.line == 1 + path.read_text().splitlines().index("x")


def test_names_with_spaces_and_colons_and_repeated_ones(tmp_path: Path) -> None:
    text = TEXT.replace("LeftArm", "rig:Left Arm").replace("LeftHand", "Hand").replace("RightHand", "Hand")
    (tmp_path / "a.bvh").write_text(text)
    motion = read_bvh(tmp_path / "a.bvh", ReadOptions(unit_metres=0.01))
    assert {"rig:Left Arm", "Hand", "Hand_2"} <= set(motion.skeleton.joint_names)
    assert any("Hand_2" in line for line in motion.provenance.operations)


def test_a_given_framerate_replaces_an_unusable_one(tmp_path: Path) -> None:
    (tmp_path / "a.bvh").write_text(bvh_text(frame_time="0"))
    motion = read_bvh(tmp_path / "a.bvh", ReadOptions(fps=Fraction(48)))
    assert motion.fps == 48 and motion.provenance.stated_fps == "Frame Time: 0"


def test_bones_that_move_leave_positions_only(tmp_path: Path) -> None:
    text = TEXT.replace("CHANNELS 3 Zrotation Xrotation Yrotation", "CHANNELS 3 Xposition Yposition Zposition", 1)
    (tmp_path / "a.bvh").write_text(text)
    motion = read_bvh(tmp_path / "a.bvh", ReadOptions(unit_metres=0.01))
    assert motion.local_rotations is not None  # the spine sits at its channels' constant place
    rows = [[0.0] * NUM_BVH_CHANNELS for _ in range(3)]
    rows[2][7] = 30.0
    moving = bvh_text(rows).replace(
        "CHANNELS 3 Zrotation Xrotation Yrotation", "CHANNELS 3 Xposition Yposition Zposition", 1
    )
    (tmp_path / "b.bvh").write_text(moving)
    motion = read_bvh(tmp_path / "b.bvh", ReadOptions(unit_metres=0.01))
    assert motion.local_rotations is None
    assert motion.joint_positions[2, 1].tolist() == pytest.approx([0, 0.3, 0])
    assert any("positions only" in line for line in motion.provenance.operations)


def test_position_channels_of_zeros_leave_the_offset(tmp_path: Path) -> None:
    head, body = TEXT.split("MOTION")
    lines = body.splitlines()
    frames = [line.split() for line in lines[3:]]
    placed = [
        cells[:6] + [f"-0.000001 0 0 {' '.join(cells[i : i + 3])}" for i in range(6, len(cells), 3)] for cells in frames
    ]
    zeros = head.replace("CHANNELS 3 ", "CHANNELS 6 Xposition Yposition Zposition ") + "MOTION"
    (tmp_path / "zeros.bvh").write_text("\n".join([zeros, *lines[1:3], *map(" ".join, placed)]) + "\n")
    (tmp_path / "plain.bvh").write_text(TEXT)
    one, other = (read_bvh(tmp_path / name) for name in ("zeros.bvh", "plain.bvh"))
    assert np.array_equal(one.joint_positions, other.joint_positions)
    assert np.array_equal(one.skeleton.offsets, other.skeleton.offsets)
