"""The project's own .npz: everything comes back; what is missing is filled in or explained; nothing else is taken."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.skeleton import KIT21, SMPL22, Feet, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io import npz
from motionkit.io.registry import ReadOptions
from tests.helpers.refusal import refusal

RIG = Skeleton(
    "rig",
    ("Hips", "Spine", "LeftFoot", "RightFoot"),
    (-1, 0, 0, 0),
    np.array([[0, 0.9, 0], [0, 0.3, 0], [0.1, -0.8, 0], [-0.1, -0.8, 0]], np.float32),
    left_right_pairs=((2, 3),),
    feet=Feet(2, 2, 3, 3),
    end_sites=((2, (0.0, -0.05, 0.125)), (3, (1 / 3, -0.05, 0.125))),
)


def body(num_frames: int = 5, num_joints: int = 22) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(num_frames, num_joints, 3)).astype(np.float32)


@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("fps", [Fraction(30), Fraction(24000, 1001)])
def test_a_motion_comes_back_as_it_was(tmp_path, fps, turned):
    rotations = np.random.default_rng(1).normal(size=(5, 4, 4)).astype(np.float32)
    rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
    before = Motion(
        body(5, 4),
        RIG,
        TimeGrid(fps, 5, 1 / 3),
        local_rotations=rotations if turned else None,
        root_translation=body(5, 1)[:, 0] if turned else None,
        captions=(Caption('says "走る"\n', 0.1, None, ""), Caption("", 0.0, 1e4, "a/b c/d")),
        action="walk, then\tturn",
        style="é",
        split="val",
        sequence_id="a/b" if turned else "",
        provenance=Provenance(
            "lab", "subset", licence="MIT", subject="07", stated_fps="29.97", operations=("one", "two")
        ),
    )
    path = tmp_path / "motion.npz"
    npz.write_npz(before, path)
    after = npz.read_npz(path)
    for name in ("timegrid", "captions", "action", "style", "split", "skeleton"):
        assert getattr(after, name) == getattr(before, name), name
    assert after.sequence_id == (before.sequence_id or "motion")
    for name in ("source", "subset", "licence", "subject", "stated_fps", "operations"):
        assert getattr(after.provenance, name) == getattr(before.provenance, name)
    for name in ("joint_positions", "local_rotations", "root_translation"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def save(path, **arrays):
    np.savez(path, **{"joint_positions": body(), "fps": 30.0} | arrays)
    return path


@pytest.mark.parametrize(
    ("clock", "fps", "start"),
    [
        ({"fps": np.float32(59.94)}, Fraction(60000, 1001), 0.0),
        ({"fps": np.array(["30000/1001"])}, Fraction(30000, 1001), 0.0),
        ({"time_seconds": 0.25 + np.arange(5) / 120}, Fraction(120), 0.25),
        (
            {"time_seconds": 7 + np.arange(5) * 1001 / 24000, "fps_numerator": 24000, "fps_denominator": 1001},
            Fraction(24000, 1001),
            7.0,
        ),
    ],
)
def test_three_kinds_of_clock(tmp_path, clock, fps, start):
    np.savez(tmp_path / "a.npz", joint_positions=body(), **clock)
    assert npz.read_npz(tmp_path / "a.npz").timegrid == TimeGrid(fps, 5, start)


@pytest.mark.parametrize(
    ("num_joints", "arrays", "parents"),
    [
        (22, {}, SMPL22.parents),
        (21, {}, KIT21.parents),
        (22, {"joint_names": np.array(SMPL22.joint_names)}, SMPL22.parents),
        (3, {"joint_names": np.array(["a", "b", "c"])}, (-1, 0, 0)),
        (3, {"joint_names": np.array([b"a", b"b", b"c"]), "parents": np.array([-1, 0, 1], np.int8)}, (-1, 0, 1)),
    ],
)
def test_a_skeleton_that_is_said_in_part(tmp_path, num_joints, arrays, parents):
    positions = body(5, num_joints)
    motion = npz.read_npz(save(tmp_path / "a.npz", joint_positions=positions, **arrays))
    assert motion.skeleton.parents == parents
    if num_joints == 3:
        np.testing.assert_allclose(motion.skeleton.offsets[2], positions[0, 2] - positions[0, parents[2]])
    else:
        assert motion.skeleton in (SMPL22, KIT21)


OBJECTS = np.array([{"a": 1}], dtype=object)


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        ({"joint_positions": np.zeros((5, 66), np.float32)}, "channel-count"),
        ({"joint_positions": np.zeros((5, 19, 3))}, "channel-count"),
        ({"joint_names": np.array(["a"])}, "channel-count"),
        ({"joint_names": np.array(["a"] * 22)}, "bones"),
        ({"joint_names": np.array([*"abcdefghijklmnopqrstuv"]), "parents": np.arange(22)}, "bones"),
        ({"fps": np.array("fast")}, "frame-time"),
        ({"fps": OBJECTS}, "frame-time"),
        ({"fps_numerator": 30, "fps_denominator": 0}, "frame-time"),
        ({"time_seconds": np.arange(5) / 60}, "frame-time"),
        ({"time_seconds": np.array([0, 1, np.nan, 3, 4]) / 30}, "frame-time"),
        ({"time_seconds": np.arange(4) / 30}, "channel-count"),
        ({"captions": OBJECTS}, "object-array"),
        ({"captions": np.array(["a"]), "caption_seconds": np.zeros((2, 2))}, "channel-count"),
        ({"local_rotations": np.ones((5, 22, 4))}, "range"),
    ],
)
def test_what_is_wrong_is_explained(tmp_path, arrays, reason):
    assert refusal(npz.read_npz, save(tmp_path / "bad.npz", **arrays)).reason == reason


def test_a_clock_is_needed_and_an_option_is_one(tmp_path):
    np.savez(tmp_path / "a.npz", joint_positions=body())
    assert refusal(npz.read_npz, tmp_path / "a.npz").reason == "no-framerate"
    assert npz.read_npz(tmp_path / "a.npz", ReadOptions(fps=Fraction(25))).fps == 25


def test_options_replace_the_clock_and_scale_every_length(tmp_path):
    before = Motion(body(5, 4) * 100, replace(RIG, offsets=RIG.offsets * np.float32(100)), TimeGrid(Fraction(30), 5))
    npz.write_npz(before, tmp_path / "a.npz")
    after = npz.read_npz(tmp_path / "a.npz", ReadOptions(fps=Fraction(60), unit_metres=0.01))
    assert after.fps == 60
    np.testing.assert_allclose(after.joint_positions, body(5, 4), atol=1e-5)
    np.testing.assert_allclose(after.skeleton.offsets, RIG.offsets, atol=1e-6)
    assert len(after.provenance.operations) == 2
