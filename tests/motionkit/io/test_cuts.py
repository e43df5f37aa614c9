"""Segments of files, worked out by hand for the framerates of AMASS."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid, parse_fps
from motionkit.io.cuts import Cut, StepCut, TimeCut, crop, missing_seconds
from tests.helpers.refusal import refusal

PATH = Path("walk.npz")


def motion_of(num_frames: int, stated: str, fps: Fraction | None = None) -> Motion:
    """A motion whose joints are all at x = the frame's number."""
    positions = np.zeros((num_frames, 22, 3), dtype=np.float32)
    positions[..., 0] = np.arange(num_frames, dtype=np.float32)[:, None]
    grid = TimeGrid(parse_fps(stated) if fps is None else fps, num_frames)
    return Motion(positions, SMPL22, grid, root_translation=positions[:, 0], provenance=Provenance(stated_fps=stated))


def missed(motion: Motion, cut: Cut) -> float:
    return missing_seconds(cut, PATH, motion.num_frames, motion.fps, motion.provenance.stated_fps)


def frames_of(motion: Motion) -> list[int]:
    return motion.joint_positions[:, 0, 0].astype(int).tolist()


@pytest.mark.parametrize(
    ("stated", "fps", "cut", "path", "first", "stop"),
    [
        ("59.94", None, StepCut(10, 20), PATH, 20, 40),
        ("59.9999885", None, StepCut(10, 20), PATH, 20, 40),
        ("120.00004577636719", None, StepCut(10, 20), PATH, 60, 120),
        ("150.0", None, StepCut(10, 20), PATH, 70, 140),
        ("20", None, StepCut(10, 20), PATH, 10, 20),
        ("Frame Time: 0.00833334", 120, StepCut(10, 20), PATH, 60, 120),
        ("about sixty", 60, StepCut(10, 20), PATH, 30, 60),
        # A trim is counted in published frames: 60 of every 7th at 150 fps are 420 native ones, 2.8 s and not 3.
        ("150", None, StepCut(3, 5, trim_frames=60), PATH, 441, 455),
        # The file says 60, a rule says 120: the published code saw 60 and took every 3rd frame.
        ("60", 120, StepCut(10, 20), PATH, 30, 60),
        # The published code did not see SMPL-X files: their corrected framerate is what SMPL+H files state.
        ("120.0", 100, StepCut(10, 20), Path("KIT/3/walk_stageii.npz"), 50, 100),
        ("120.0", 100, StepCut(10, 20), Path("KIT/3/walk_poses.npz"), 60, 120),
        ("120.0", 60, StepCut(10, 20, 20, seen_fps=60.0), PATH, 90, 120),
        ("120.0", 60, StepCut(10, 20, seen_fps=59.9999885), Path("SSM/x/walk_stageii.npz"), 20, 40),
        ("59.9999885", 60, StepCut(10, 20, seen_fps=120.0), Path("SSM_synced/x/walk_poses.npz"), 20, 40),
    ],
)
def test_native_frames_of_published_ones(stated, fps, cut, path, first, stop):
    motion = motion_of(1000, stated, None if fps is None else Fraction(fps))
    cropped = crop(motion, cut, path)
    assert frames_of(cropped) == list(range(first, stop))
    assert (cropped.fps, cropped.timegrid.start_seconds) == (motion.fps, 0.0)
    assert missing_seconds(cut, path, cropped.num_frames, motion.fps, stated) == 0.0
    assert np.array_equal(cropped.root_translation, cropped.joint_positions[:, 0])


@given(
    num_frames=st.integers(1, 400),
    rate=st.sampled_from(["60", "59.94", "100", "120", "150", "250"]),
    start=st.integers(0, 30),
    length=st.integers(1, 30),
    trim=st.sampled_from([0, 3]),
)
def test_both_kinds_agree_with_slicing_as_published(num_frames, rate, start, length, trim):
    motion = motion_of(num_frames, rate)
    step = int(float(rate) / 20)
    published = list(range(num_frames))[::step][trim:][start : start + length]
    cut = StepCut(start, start + length, trim)
    if not published:
        assert refusal(crop, motion, cut, PATH).reason == "beyond-end"
        return
    thinned = crop(motion, replace(cut, published=True), PATH)
    native = crop(motion, cut, PATH)
    assert frames_of(thinned) == frames_of(native)[::step] == published
    assert native.num_frames <= length * step
    assert (thinned.fps, native.fps) == (20, motion.fps)
    short = length - len(published)
    assert missed(native, cut) == pytest.approx(float(short * step / motion.fps))
    assert missed(thinned, replace(cut, published=True)) == pytest.approx(short / 20)


@pytest.mark.parametrize(
    ("fps", "start", "end", "expected"),
    [
        ("100", 0.5, 0.53, [50, 51, 52]),
        ("30", 0.0, None, list(range(60))),
        ("30", 0.51, 0.6, [16, 17]),
        ("30000/1001", 1001 / 30000 * 7, 1001 / 30000 * 9, [7, 8]),
    ],
)
def test_seconds_are_half_open(fps: str, start: float, end: float | None, expected: list[int]) -> None:
    assert frames_of(crop(motion_of(60, fps, fps=parse_fps(fps)), TimeCut(start, end), PATH)) == expected


def test_seconds_beyond_the_end_are_missed_and_framerates_below_20_have_no_step() -> None:
    assert refusal(crop, motion_of(50, "15"), StepCut(0, 5), PATH).reason == "step"
    motion = crop(motion_of(100, "100"), TimeCut(0.5, 1.5), PATH)
    assert motion.num_frames == 50
    assert missed(motion, TimeCut(0.5, 1.5)) == pytest.approx(0.5)
    assert missed(motion, TimeCut(0.5, 1.01)) == missed(motion, TimeCut(0.5, None)) == 0.0


@pytest.mark.parametrize(
    ("stated", "fps", "factor"),
    [("20", 15, 4 / 3), ("120", 120, 1.0), ("59.9999885", 60, 2 / 3), ("150", 150, 14 / 15), ("60", 120, 0.5)],
)
def test_seconds_of_captions_become_true_ones(stated: str, fps: int, factor: float) -> None:
    # The second published second begins at published frame 20, native frame 20·step.
    captions = (Caption("all of it"), Caption("a part", 1.0, 2.0), Caption("the rest", 2.0))
    motion = replace(motion_of(1000, stated, fps=Fraction(fps)), captions=captions, action="walk", sequence_id="x")
    cropped = crop(motion, StepCut(0, 60), PATH)
    whole, part, rest = cropped.captions
    assert (whole, cropped.action, cropped.sequence_id) == (captions[0], "walk", "x")
    assert (part.start_seconds, part.end_seconds) == pytest.approx((factor, 2 * factor))
    assert (rest.start_seconds, rest.end_seconds) == (pytest.approx(2 * factor), None)
    assert any("captions' seconds" in line for line in cropped.provenance.operations) == (factor != 1.0)
    assert crop(motion, StepCut(0, 60, published=True), PATH).captions == captions
