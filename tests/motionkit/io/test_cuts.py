"""Frame windows of stretches, worked out by hand for the framerates of AMASS."""

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.errors import FormatError
from motionkit.core.framerate import parse_fps
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.io.cuts import (
    Cut,
    PublishedCut,
    StepCut,
    TimeCut,
    crop,
    missing_seconds,
    published_step,
    stated_rate,
    unlike_stated_seconds,
)

PATH = Path("take.npz")


def take(num_frames: int, stated: str, fps: Fraction | None = None) -> Motion:
    """A take whose joints are all at x = the frame's number."""
    positions = np.zeros((num_frames, 22, 3), dtype=np.float32)
    positions[..., 0] = np.arange(num_frames, dtype=np.float32)[:, None]
    grid = TimeGrid(parse_fps(stated) if fps is None else fps, num_frames)
    return Motion(positions, SMPL22, grid, root_translation=positions[:, 0], provenance=Provenance(stated_fps=stated))


def missed(motion: Motion, cut: Cut) -> float:
    return missing_seconds(cut, PATH, motion.num_frames, motion.fps, motion.provenance.stated_fps)


def frames_of(motion: Motion) -> list[int]:
    return motion.joint_positions[:, 0, 0].astype(int).tolist()


def test_of_smplx_files_the_corrected_framerate_counts_as_the_other_release_says_it():
    motion = take(400, "120.0", Fraction(100))
    assert frames_of(crop(motion, StepCut(10, 20), Path("KIT/3/walk_stageii.npz"))) == list(range(50, 100))
    assert frames_of(crop(motion, StepCut(10, 20), Path("KIT/3/walk_poses.npz"))) == list(range(60, 120))


@pytest.mark.parametrize(
    ("stated", "step", "first", "stop"),
    [
        ("60", 3, 30, 60),
        ("59.94", 2, 20, 40),
        ("59.9999885", 2, 20, 40),
        ("100.0", 5, 50, 100),
        ("120.0", 6, 60, 120),
        ("120.00004577636719", 6, 60, 120),
        ("150.0", 7, 70, 140),
        ("250.0", 12, 120, 240),
        ("20", 1, 10, 20),
    ],
)
def test_the_native_frames_of_published_frames_10_to_20(stated, step, first, stop):
    motion = take(400, stated)
    assert published_step(StepCut(10, 20), PATH, motion.fps, stated) == step
    cropped = crop(motion, StepCut(10, 20), PATH)
    assert frames_of(cropped) == list(range(first, stop))
    assert cropped.fps == parse_fps(stated)
    assert cropped.timegrid.start_seconds == 0.0
    assert missed(cropped, StepCut(10, 20)) == 0.0
    assert np.array_equal(cropped.root_translation, cropped.joint_positions[:, 0])


def test_a_trim_is_counted_in_published_frames():
    # Eyes_Japan at 150 fps: 60 frames of every 7th are 420 native ones, 2.8 s and not 3.
    cropped = crop(take(1000, "150"), StepCut(3, 5, trim_frames=60), PATH)
    assert frames_of(cropped) == list(range(441, 455))


def test_a_corrected_framerate_moves_the_clock_and_not_the_frames():
    # The file says 60, a rule says 120: the published code saw 60 and took every 3rd frame.
    cropped = crop(take(400, "60", fps=Fraction(120)), StepCut(10, 20), PATH)
    assert frames_of(cropped) == list(range(30, 60))
    assert (cropped.fps, cropped.duration_seconds) == (120, 0.25)
    assert "0.25 s to 0.5 s of the file" in cropped.provenance.operations[-1]


@pytest.mark.parametrize(
    ("stated", "fps", "rate"),
    [
        ("", 120, 120.0),
        ("Frame Time: .0083333", 120, 120.0),
        ("Frame Time: 0.00833334", 120, 120.0),
        ("Frame Time: 0", 30, 30.0),
        ("nan", 50, 50.0),
        ("-1", 50, 50.0),
        ("about sixty", 60, 60.0),
        ("59.9999885", 60, 59.9999885),
    ],
)
def test_what_counts_as_the_framerate_that_a_file_states(stated, fps, rate):
    assert stated_rate(stated, Fraction(fps)) == rate


def test_the_published_frames_are_every_step_th_called_20_fps():
    cut = PublishedCut(StepCut(2, 6, trim_frames=1))
    motion = crop(take(100, "150"), cut, PATH)
    assert frames_of(motion) == [21, 28, 35, 42]
    assert (motion.fps, motion.num_frames) == (20, 4)
    assert "at 21.4286 fps, called 20 fps" in motion.provenance.operations[-1]
    assert missed(motion, cut) == 0.0


def test_a_whole_file_that_was_published_as_it_is():
    # HumanAct12, which a rule puts at 15 fps: a caption's second is 20 of its frames.
    cut = StepCut(0, None, seen_fps=20.0)
    motion = replace(take(8, "20", fps=Fraction(15)), captions=(Caption("a part", 0.15, 0.3),))
    native, published = crop(motion, cut, PATH), crop(motion, PublishedCut(cut), PATH)
    assert frames_of(native) == frames_of(published) == list(range(8))
    assert (native.fps, published.fps) == (15, 20)
    assert (native.captions[0].start_seconds, native.captions[0].end_seconds) == pytest.approx((0.2, 0.4))
    assert published.captions == motion.captions
    assert missed(native, cut) == missed(published, PublishedCut(cut)) == 0.0


def test_another_release_states_what_the_published_code_did_not_see():
    # TotalCapture: SMPL+H files say 60, SMPL-X files of the same frames 120, and a rule puts them right.
    seen = crop(take(400, "60.0"), StepCut(10, 20, 20), PATH)
    cut = StepCut(10, 20, 20, seen_fps=60.0)
    assert frames_of(crop(take(400, "120.0", fps=Fraction(60)), cut, PATH)) == frames_of(seen) == list(range(90, 120))
    assert missing_seconds(cut, PATH, 27, Fraction(60), "120.0") == pytest.approx(3 / 60)


def test_the_release_that_the_published_code_read_says_itself_what_it_saw():
    # SSM: SMPL+H files of 60 fps say 59.9999885 or 120, SMPL-X files of the same frames 120.
    for seen, step in ((59.9999885, 2), (120.0, 6)):
        cut = StepCut(10, 20, seen_fps=seen)
        smplx = crop(take(400, "120.0", fps=Fraction(60)), cut, Path("SSM/20160330_03333/walking_stageii.npz"))
        assert frames_of(smplx) == list(range(10 * step, 20 * step))
    assert published_step(cut, Path("SSM_synced/20160330_03333/walking_poses.npz"), Fraction(60), "59.9999885") == 2


@given(
    num_frames=st.integers(1, 400),
    rate=st.sampled_from(["60", "59.94", "100", "120", "150", "250"]),
    start=st.integers(0, 30),
    length=st.integers(1, 30),
    trim=st.sampled_from([0, 3]),
)
def test_both_cuts_agree_with_slicing_as_published(num_frames, rate, start, length, trim):
    motion = take(num_frames, rate)
    step = int(float(rate) / 20)
    published = list(range(num_frames))[::step][trim:][start : start + length]
    cut = StepCut(start, start + length, trim)
    if not published:
        with pytest.raises(FormatError) as caught:
            crop(motion, cut, PATH)
        assert caught.value.reason == "beyond-end"
        return
    assert frames_of(crop(motion, PublishedCut(cut), PATH)) == published
    native = crop(motion, cut, PATH)
    assert frames_of(native)[::step] == published
    assert native.num_frames <= length * step
    short = length - len(published)
    assert missed(native, cut) == pytest.approx(float(short * step / motion.fps))
    assert missed(crop(motion, PublishedCut(cut), PATH), PublishedCut(cut)) == pytest.approx(short / 20)


@pytest.mark.parametrize(
    ("fps", "start", "end", "expected"),
    [
        ("100", 0.5, 0.53, [50, 51, 52]),
        ("120", 0.1, 0.125, [12, 13, 14]),
        ("30", 0.0, None, list(range(40))),
        ("30", 0.51, 0.6, [16, 17]),
        ("30000/1001", 1001 / 30000 * 7, 1001 / 30000 * 9, [7, 8]),
    ],
)
def test_seconds_are_half_open(fps, start, end, expected):
    motion = take(40 if fps == "30" else 60, fps, fps=parse_fps(fps))
    assert frames_of(crop(motion, TimeCut(start, end), PATH)) == expected


def test_seconds_beyond_the_end_are_missed():
    motion = crop(take(100, "100"), TimeCut(0.5, 1.5), PATH)
    assert motion.num_frames == 50
    assert missed(motion, TimeCut(0.5, 1.5)) == pytest.approx(0.5)
    assert missed(motion, TimeCut(0.5, 1.01)) == 0.0
    assert missed(motion, TimeCut(0.5, None)) == 0.0


@pytest.mark.parametrize(
    ("num_frames", "fps", "stated", "unlike"),
    [
        (600, 100, 6.0, False),
        (600, 100, 6.2, False),
        (600, 120, 6.0, True),
        (1200, 60, 10.0, True),
        (20, 60, 0.5, False),
    ],
)
def test_a_whole_file_that_is_not_as_long_as_stated(num_frames, fps, stated, unlike):
    assert unlike_stated_seconds(TimeCut(file_seconds=stated), num_frames, Fraction(fps)) == unlike
    assert not unlike_stated_seconds(TimeCut(1.0, None, stated), num_frames, Fraction(fps))
    assert not unlike_stated_seconds(TimeCut(), num_frames, Fraction(fps))


def test_framerates_below_20_have_no_step():
    with pytest.raises(FormatError, match="15 frames a second") as caught:
        crop(take(50, "15"), StepCut(0, 5), PATH)
    assert caught.value.reason == "step"


def test_a_crop_keeps_what_else_is_known():
    motion = replace(take(40, "60"), action="walk", sequence_id="x")
    cropped = crop(motion, StepCut(0, 2), PATH)
    assert (cropped.action, cropped.sequence_id, cropped.skeleton) == ("walk", "x", SMPL22)
    assert cropped.num_frames == math.prod((2, 3))


@pytest.mark.parametrize(
    ("stated", "fps", "factor"),
    [("120", 120, 1.0), ("59.9999885", 60, 2 / 3), ("150", 150, 14 / 15), ("250", 250, 0.96), ("60", 120, 0.5)],
)
def test_seconds_of_captions_become_true_ones(stated, fps, factor):
    # The second published second begins at published frame 20, native frame 20·step.
    captions = (Caption("all of it"), Caption("a part", 1.0, 2.0), Caption("the rest", 2.0))
    motion = replace(take(1000, stated, fps=Fraction(fps)), captions=captions)
    whole, part, rest = crop(motion, StepCut(0, 60), PATH).captions
    assert whole == captions[0]
    assert (part.start_seconds, part.end_seconds) == pytest.approx((factor, 2 * factor))
    assert (rest.start_seconds, rest.end_seconds) == (pytest.approx(2 * factor), None)
    logged = crop(motion, StepCut(0, 60), PATH).provenance.operations
    assert any("captions' seconds" in line for line in logged) == (factor != 1.0)
    assert crop(motion, PublishedCut(StepCut(0, 60)), PATH).captions == captions
