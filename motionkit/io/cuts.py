"""Cutting sequences out of files: segments in seconds, and segments in HumanML3D's frames.

HumanML3D counts in frames of its own. From a file that states `fps` it keeps every `step`-th frame, step =
int(fps / 20), calls the result 20 fps, trims the start for some datasets, and then takes frames [start, end). Since the
step is an integer, those frames are at fps / step, not at 20 (150 fps: 21.43; 59.9999885 fps: 30), so they are
converted to native frames once the file's framerate is known. Source: HumanML3D, raw_pose_processing.ipynb, issue 176.
"""

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.timegrid import SAME_SECONDS, SNAP_TOLERANCE, TimeGrid, parse_fps

PUBLISHED_FPS = 20
# AMASS' releases differ by some frames at the ends of files; wrong framerates differ by a fifth or more.
UNLIKE_SECONDS = 0.25
UNLIKE_SHARE = 0.05


@dataclass(frozen=True)
class TimeCut:
    """Seconds [start_seconds, end_seconds) of a file; None: to its end. `file_seconds` is the file's stated length."""

    start_seconds: float = 0.0
    end_seconds: float | None = None
    file_seconds: float | None = None

    @property
    def is_whole(self) -> bool:
        """Whether it is the whole file."""
        return self.start_seconds == 0.0 and self.end_seconds is None


@dataclass(frozen=True)
class StepCut:
    """Frames [start_frame, end_frame) of every step-th frame of a file, after dropping `trim_frames` of them.

    All native frames in between are kept: [(trim + start)·step, (trim + end)·step); `end_frame` None is the file's end.
    If `published`, only every step-th of them is, and they are called 20 fps, as HumanML3D does. `seen_fps` is the
    framerate that HumanML3D's code read, if other releases of the file may state another one.
    """

    start_frame: int
    end_frame: int | None
    trim_frames: int = 0
    seen_fps: float | None = None
    published: bool = False


Cut = TimeCut | StepCut


def crop(motion: Motion, cut: Cut, path: Path) -> Motion:
    """The segment as a motion whose clock starts at 0; it is shorter if the file ends early.

    Captions are relative to the segment; those of a `StepCut` are converted from seconds of 20 frames to true seconds,
    unless it is `published`. Raises `FormatError`: `beyond-end` if the file ends before the segment starts, `step` for
    a framerate below 20.
    """
    if isinstance(cut, TimeCut):
        if cut.is_whole:
            return motion
        start = _first_frame_at(cut.start_seconds, motion.fps)
        stop = motion.num_frames if cut.end_seconds is None else _first_frame_at(cut.end_seconds, motion.fps)
        end = "the end" if cut.end_seconds is None else f"{cut.end_seconds:g} s"
        return _frames(motion, start, stop, f"{cut.start_seconds:g} s to {end}", path)
    stated = motion.provenance.stated_fps
    step = _published_step(cut, path, motion.fps, stated)
    if step < 1:
        message = f"{float(motion.fps):g} frames a second; an index in HumanML3D's frames needs {PUBLISHED_FPS} or more"
        raise FormatError(message, path=path, reason="step")
    if (cut.start_frame, cut.end_frame, cut.trim_frames) != (0, None, 0):
        start = (cut.trim_frames + cut.start_frame) * step
        stop = motion.num_frames if cut.end_frame is None else (cut.trim_frames + cut.end_frame) * step
        trim = f" after a trim of {cut.trim_frames}" if cut.trim_frames else ""
        segment = f"[{cut.start_frame}, {cut.end_frame or ''}) of one frame in {step}{trim}"
        motion = _frames(motion, start, stop, segment, path)
    return _as_published(motion, step) if cut.published else _with_true_seconds(motion, step)


def missing_seconds(cut: Cut, path: Path, num_frames: int, fps: Fraction, stated_fps: str) -> float:
    """How much shorter a cropped motion is than its cut, in seconds; 0 within the rounding to frames."""
    if isinstance(cut, TimeCut):
        missing = 0.0 if cut.end_seconds is None else cut.end_seconds - cut.start_seconds - float(num_frames / fps)
        return missing if missing > 1.5 / float(fps) else 0.0
    if cut.end_frame is None:
        return 0.0
    expected = cut.end_frame - cut.start_frame
    if cut.published:
        return (expected - num_frames) / PUBLISHED_FPS
    # The last published frame represents `step` native ones, of which the file needs only the first.
    step = _published_step(cut, path, fps, stated_fps)
    return float((expected - math.ceil(num_frames / step)) * step / fps)


def unlike_stated_seconds(cut: Cut, num_frames: int, fps: Fraction) -> bool:
    """Whether a whole file's duration differs notably from its index's: a sign of a wrong framerate."""
    if not isinstance(cut, TimeCut) or not cut.is_whole or cut.file_seconds is None:
        return False
    return abs(float(num_frames / fps) - cut.file_seconds) > max(UNLIKE_SECONDS, UNLIKE_SHARE * cut.file_seconds)


def _published_step(cut: StepCut, path: Path, fps: Fraction, stated_fps: str) -> int:
    """HumanML3D's step, int(fps / 20), from the exact framerate that its code read; 0 below 20 fps.

    Its code read SMPL+H files (NAME_poses), so these state that framerate themselves: a correction to `fps` changes a
    frame's time, not which frames were published. For other files the index may give it. SMPL-X files (NAME_stageii)
    state 120 for nearly all sequences; framerate_rules.toml corrects them to the SMPL+H files' framerates.
    """
    rate = _stated_rate(stated_fps, fps)
    if cut.seen_fps is not None and not path.stem.endswith("_poses"):
        rate = cut.seen_fps
    elif path.stem.endswith("_stageii") and abs(rate - float(fps)) > SNAP_TOLERANCE * float(fps):
        rate = float(fps)
    return int(rate / PUBLISHED_FPS)


def _stated_rate(stated_fps: str, fps: Fraction) -> float:
    """The framerate that a file states, unrounded if it is a number, else the one in use.

    BVH's `Frame Time` is printed with few digits (.00833334 s), so the snapped framerate is used there.
    """
    stated = stated_fps.strip()
    try:
        if stated.startswith("Frame Time:"):
            return float(parse_fps(1.0 / float(stated.removeprefix("Frame Time:"))))
        rate = float(stated)
    except (ValueError, ZeroDivisionError):
        return float(fps)
    return rate if math.isfinite(rate) and rate > 0 else float(fps)


def _first_frame_at(seconds: float, fps: Fraction) -> int:
    # Half-open intervals: the first frame that is not earlier.
    return max(0, math.ceil((seconds - SAME_SECONDS) * float(fps)))


def _frames(motion: Motion, start: int, stop: int, segment: str, path: Path) -> Motion:
    end = min(stop, motion.num_frames)
    if start >= end:
        message = f"{motion.sequence_id!r} is {segment}, frames [{start}, {stop}), but the file has {motion.num_frames}"
        raise FormatError(message, path=path, reason="beyond-end")
    first, last = (float(frame / motion.fps) for frame in (start, end))
    line = f"frames [{start}, {end}) of {motion.num_frames}, {first:.6g} s to {last:.6g} s of the file ({segment})"
    return replace(motion.frames(start, end), timegrid=TimeGrid(motion.fps, end - start)).logged(line)


def _with_true_seconds(motion: Motion, step: int) -> Motion:
    # A caption's second is 20 published frames, that is 20·step native ones.
    factor = float(PUBLISHED_FPS * step / motion.fps)
    if factor == 1.0 or all((each.start_seconds, each.end_seconds) == (0.0, None) for each in motion.captions):
        return motion
    ends = (None if each.end_seconds is None else each.end_seconds * factor for each in motion.captions)
    captions = tuple(
        replace(caption, start_seconds=caption.start_seconds * factor, end_seconds=end)
        for caption, end in zip(motion.captions, ends, strict=True)
    )
    line = f"captions' seconds × {factor:.6g}: they were counted at {float(motion.fps / step):g} fps called 20"
    return replace(motion, captions=captions).logged(line)


def _as_published(motion: Motion, step: int) -> Motion:
    rotations, root = motion.local_rotations, motion.root_translation
    positions = motion.joint_positions[::step]
    thinned = replace(
        motion,
        joint_positions=positions,
        timegrid=TimeGrid(Fraction(PUBLISHED_FPS), len(positions)),
        local_rotations=None if rotations is None else rotations[::step],
        root_translation=None if root is None else root[::step],
    )
    true_fps = float(motion.fps / step)
    return thinned.logged(f"one frame in {step}, at {true_fps:g} fps, called {PUBLISHED_FPS} fps as HumanML3D does")
