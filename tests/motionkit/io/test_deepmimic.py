"""DeepMimic's JSON motions: real clips, known poses, and what is wrong with bad files."""

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.io.deepmimic import humanoid3d, read_deepmimic
from motionkit.io.scan import read, scan
from tests.helpers.bones import check_body
from tests.helpers.refusal import refusal

REAL_FRAMERATES = {"16": 2, "24": 4, "30": 5, "60": 9, "120": 53}


def standing(duration: float = 1 / 30) -> list[float]:
    """One frame: upright, the root at a height of 0.9 m."""
    frame = [duration, 0.0, 0.9, 0.0]
    for size in humanoid3d().rotation_sizes:
        frame += {4: [1.0, 0.0, 0.0, 0.0], 1: [0.0], 0: []}[size]
    return frame


def written(path: Path, frames: Any) -> Path:
    path.write_text(json.dumps({"Loop": "none", "Frames": frames}))
    return path


def test_a_bent_knee_and_a_turned_root_put_the_foot_where_geometry_says(tmp_path: Path) -> None:
    bent = standing()
    bent[20] = -np.pi / 2  # the right knee: duration, position, root, chest, neck and right hip come before it
    turned = standing()
    turned[4:8] = [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]
    motion = read_deepmimic(written(tmp_path / "humanoid3d_kick_a.txt", [standing(), bent, turned, standing(0.0)]))
    assert motion.fps == 30 and motion.num_frames == 4 and motion.action == "kick_a"
    ankle, wrist = motion.skeleton.index("right_ankle"), motion.skeleton.index("left_wrist")
    assert np.allclose(motion.joint_positions[0, ankle], (0.0, 0.9 - 0.421546 - 0.40987, 0.084887), atol=1e-6)
    # It faces +x, so a knee that bends takes the foot to −x.
    assert np.allclose(motion.joint_positions[1, ankle], (-0.40987, 0.9 - 0.421546, 0.084887), atol=1e-6)
    # A quarter turn about y takes its left (−z) to −x.
    x, y, z = motion.joint_positions[0, wrist]
    assert np.allclose(motion.joint_positions[2, wrist], (z, y, -x), atol=1e-6)


def test_every_real_clip_is_a_body_at_its_own_framerate(captures: Path) -> None:
    found = scan([captures / "deepmimic"])
    assert len(found.items) == 74 and not found.problems
    counts: dict[str, int] = {}
    for item in found.items:
        if item.path.stem == "humanoid3d_roll":
            assert (refusal(read, item).reason, refusal(read, item).frame) == ("frame-time", 5)
            continue
        motion = read(item)
        check_body(motion)
        counts[str(motion.fps)] = counts.get(str(motion.fps), 0) + 1
        assert -0.1 < motion.joint_positions[..., 1].min() < 0.1
        assert motion.action and motion.provenance.licence
    assert counts == REAL_FRAMERATES


@pytest.mark.parametrize(
    ("durations", "fps"),
    [
        ([0.033332, 0.033332, 0.0], Fraction(30)),
        ([0.0625, 0.0625, 9.0], Fraction(16)),
        ([1001 / 60000, 1001 / 60000, 0.0], Fraction(60000, 1001)),
    ],
)
def test_the_last_duration_says_nothing(tmp_path: Path, durations: list[float], fps: Fraction) -> None:
    motion = read_deepmimic(written(tmp_path / "m.txt", [standing(duration) for duration in durations]))
    assert motion.fps == fps and motion.provenance.stated_fps.startswith("2 × ")


FRAMES = [
    ([], "no-frames"),
    ([standing(), standing()[:-1]], "channel-count"),
    ([standing(), 1.0], "channel-count"),
    ([standing(-1.0), standing(-1.0), standing()], "frame-time"),
    ([standing(0.0)], "no-framerate"),
    ([standing(), ["1", *standing()[1:]]], "channel-count"),
    ([standing(), [float("nan"), *standing()[1:]]], "nan"),
    ([standing(), [*standing()[:2], 1e9, *standing()[3:]]], "range"),
    ([standing(), [*standing()[:4], 0.0, *standing()[5:]]], "range"),
    ({"0": standing()}, "not-what-it-says"),
]
CONTENTS = [(b'{"Loop": "w\xffrap", "Frames": []}', "encoding"), (b'{"Frames": ' + b"[" * 100_000, "not-what-it-says")]


@pytest.mark.parametrize(
    ("content", "reason"), [*((json.dumps({"Frames": frames}).encode(), why) for frames, why in FRAMES), *CONTENTS]
)
def test_bad_files_are_refused_with_a_reason(tmp_path: Path, content: bytes, reason: str) -> None:
    (tmp_path / "m.txt").write_bytes(content)
    assert refusal(read_deepmimic, tmp_path / "m.txt").reason == reason
