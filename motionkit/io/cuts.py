"""Cutting files into sequences: stretches in seconds, and stretches in HumanML3D's frames.

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
from motionkit.core.framerate import SNAP_TOLERANCE, parse_fps
from motionkit.core.motion import Motion
from motionkit.core.timegrid import SAME_SECONDS, TimeGrid

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
    `seen_fps` is the framerate that HumanML3D's code read, if other files of the take may state another one.
    """

    start_frame: int
    end_frame: int | None
    trim_frames: int = 0
    seen_fps: float | None = None


@dataclass(frozen=True)
class PublishedCut:
    """The frames that HumanML3D published: every step-th of a stretch, treated as 20 fps."""

    stretch: StepCut


Cut = TimeCut | StepCut | PublishedCut


def crop(motion: Motion, cut: Cut, path: Path) -> Motion:
    """The stretch as a motion whose clock starts at 0; it is shorter if the file ends early.

    Captions are relative to the stretch; those of a `StepCut` are converted from seconds of 20 frames to true seconds.
    Raises `FormatError`: `beyond-end` if the file ends before the stretch starts, `step` for a framerate below 20.
    """
    match cut:
        case TimeCut():
            return _crop_seconds(motion, cut, path)
        case StepCut():
            step = _step(motion, cut, path)
            return _with_true_seconds(_crop_frames(motion, cut, step, path), step)
        case PublishedCut(stretch):
            step = _step(motion, stretch, path)
            return _called_20_fps(_crop_frames(motion, stretch, step, path), step)


def missing_seconds(cut: Cut, path: Path, num_frames: int, fps: Fraction, stated_fps: str) -> float:
    """How much shorter a cropped motion is than its cut, in seconds; 0 within the rounding to frames."""
    match cut:
        case TimeCut(start, end, _):
            missing = 0.0 if end is None else end - start - float(num_frames / fps)
            return missing if missing > 1.5 / float(fps) else 0.0
        case StepCut(start_frame, end_frame):
            # The last published frame represents `step` native ones, of which the file needs only the first.
            step = published_step(cut, path, fps, stated_fps)
            found = math.ceil(num_frames / step)
            return 0.0 if end_frame is None else float((end_frame - start_frame - found) * step / fps)
        case PublishedCut(StepCut(start_frame, end_frame)):
            return 0.0 if end_frame is None else (end_frame - start_frame - num_frames) / PUBLISHED_FPS


def published_step(cut: StepCut, path: Path, fps: Fraction, stated_fps: str) -> int:
    """HumanML3D's step, int(fps / 20), from the exact framerate that its code read; 0 below 20 fps.

    Its code read SMPL+H files (NAME_poses), so these state that framerate themselves: a correction to `fps` changes a
    frame's time, not which frames were published. For other files the index may give it. SMPL-X files (NAME_stageii)
    state 120 for nearly all takes; `framerate_rules` corrects them to the SMPL+H files' framerates.
    """
    return int(_seen_rate(cut, path, fps, stated_fps) / PUBLISHED_FPS)


def _seen_rate(cut: StepCut, path: Path, fps: Fraction, stated_fps: str) -> float:
    stated = stated_rate(stated_fps, fps)
    if cut.seen_fps is not None and not path.stem.endswith("_poses"):
        return cut.seen_fps
    corrected = abs(stated - float(fps)) > SNAP_TOLERANCE * float(fps)
    return float(fps) if corrected and path.stem.endswith("_stageii") else stated


def unlike_stated_seconds(cut: Cut, num_frames: int, fps: Fraction) -> bool:
    """Whether a whole file's duration differs notably from its index's: a sign of a wrong framerate."""
    if not isinstance(cut, TimeCut) or not cut.is_whole or cut.file_seconds is None:
        return False
    return abs(float(num_frames / fps) - cut.file_seconds) > max(UNLIKE_SECONDS, UNLIKE_SHARE * cut.file_seconds)


def stated_rate(stated_fps: str, fps: Fraction) -> float:
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


def _crop_seconds(motion: Motion, cut: TimeCut, path: Path) -> Motion:
    if cut.is_whole:
        return motion
    start = _first_frame_at(cut.start_seconds, motion.fps)
    stop = motion.num_frames if cut.end_seconds is None else _first_frame_at(cut.end_seconds, motion.fps)
    end = "the end" if cut.end_seconds is None else f"{cut.end_seconds:g} s"
    return _stretch(motion, start, stop, f"{cut.start_seconds:g} s to {end}", path)


def _step(motion: Motion, cut: StepCut, path: Path) -> int:
    stated = motion.provenance.stated_fps
    step = published_step(cut, path, motion.fps, stated)
    if step < 1:
        raise FormatError(
            f"{_seen_rate(cut, path, motion.fps, stated):g} frames a second; an index in HumanML3D's frames needs at "
            f"least {PUBLISHED_FPS}",
            path=path,
            reason="step",
        )
    return step


def _crop_frames(motion: Motion, cut: StepCut, step: int, path: Path) -> Motion:
    if (cut.start_frame, cut.end_frame, cut.trim_frames) == (0, None, 0):
        return motion
    start = (cut.trim_frames + cut.start_frame) * step
    stop = motion.num_frames if cut.end_frame is None else (cut.trim_frames + cut.end_frame) * step
    trim = f" after a trim of {cut.trim_frames}" if cut.trim_frames else ""
    asked = f"[{cut.start_frame}, {cut.end_frame or ''}) of one frame in {step}{trim}"
    return _stretch(motion, start, stop, asked, path)


def _with_true_seconds(motion: Motion, step: int) -> Motion:
    # A caption's second is 20 published frames, that is 20·step native ones.
    factor = float(PUBLISHED_FPS * step / motion.fps)
    if factor == 1.0 or all((each.start_seconds, each.end_seconds) == (0.0, None) for each in motion.captions):
        return motion
    captions = tuple(
        replace(
            caption,
            start_seconds=caption.start_seconds * factor,
            end_seconds=None if caption.end_seconds is None else caption.end_seconds * factor,
        )
        for caption in motion.captions
    )
    line = f"captions' seconds × {factor:.6g}: they were counted at {float(motion.fps / step):g} fps called 20"
    return replace(motion, captions=captions).logged(line)


def _stretch(motion: Motion, start: int, stop: int, asked: str, path: Path) -> Motion:
    if start >= min(stop, motion.num_frames):
        raise FormatError(
            f"the index asks for {asked} as {motion.sequence_id!r}, that is frames [{start}, {stop}), but the file has "
            f"{motion.num_frames}; is it of another release?",
            path=path,
            reason="beyond-end",
        )
    found = min(stop, motion.num_frames)
    cropped = motion.frames(start, found)
    first, last = (float(frame / motion.fps) for frame in (start, found))
    line = f"frames [{start}, {found}) of {motion.num_frames}, {first:.6g} s to {last:.6g} s of the file ({asked})"
    return replace(cropped, timegrid=TimeGrid(motion.fps, found - start)).logged(line)


def _called_20_fps(motion: Motion, step: int) -> Motion:
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


def _first_frame_at(seconds: float, fps: Fraction) -> int:
    # Half-open intervals: the first frame that is not earlier.
    return max(0, math.ceil((seconds - SAME_SECONDS) * float(fps)))
