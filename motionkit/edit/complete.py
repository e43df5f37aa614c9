"""Completing a motion: more frames between its own, gaps filled, ends extended (docs/complete.md)."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import default_path
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.core.shapes import Bool
from motionkit.core.timegrid import Framerate, parse_fps
from motionkit.edit.encoders import ChosenEncoder, choose_encoder
from motionkit.edit.motions import EditedMotion, LoadedMotion, load_motion, write_as_loaded
from motionkit.fields.anchoring import anchored
from motionkit.fields.contact.planted import planted
from motionkit.fields.resample import begin_completion
from motionkit.fields.rig import on_bones
from motionkit.io.bvh import KnownFrames

# More than a minute of extrapolation is probably a typo.
LONGEST_REACH_SECONDS = 60.0
# Extrapolation at constant velocity is implausible beyond this.
LONGEST_PLAUSIBLE_SECONDS = 0.5

# Frames [start, stop); None is the end.
FrameRange = tuple[int, int | None]
Frames = Bool[np.ndarray, "frames"]
Seconds = int | float
_RANGE = re.compile(r"(?P<start>\d*)(?P<colon>:?)(?P<stop>\d*)")


def complete(
    motion: Motion | str | Path,
    *,
    fps: Framerate | None = None,
    keep: str | Sequence[FrameRange] | Frames | None = None,
    extend: str | Seconds | tuple[Seconds, Seconds] | None = None,
    plant: bool = False,
    model: str | None = None,
    run: str | Path | None = None,
) -> Motion:
    """A motion with more frames, gaps filled, ends continued; given frames and bone lengths are kept.

    - `motion`: a motion, or a file; frames of a file that hold nan are filled like gaps
    - `fps`: the new framerate, not below its own (`resample` filters it down)
    - `keep`: the frames to keep, all others are replaced: `[(0, 10), (40, None)]`, half-open and counted from 0, or
      "0:10,40:", or a mask of one bool for each frame
    - `extend`: seconds to add after it; or a pair, before and after
    - `plant`: whether to remove foot sliding from the new frames (`motionkit.plant` is for a whole motion)
    - `model`: an interpolator (`spline`, `slerp`, `hold` …) or the name of a trained encoder; by default the
      preferred encoder (PA-HiRes) if ./runs holds a trained one, else `spline`
    - `run`: the run of a trained encoder, by default the one trained last

    Warns if a request exceeds the range of a trained encoder's training. Raises `MotionkitError` for a request that
    this motion does not allow, `UsageError` for an invalid one.

    >>> motion = mk.read("walk.bvh")
    >>> mk.complete(motion, fps=120, model="spline").num_frames
    479
    >>> mk.complete(motion, keep=[(0, 30), (60, None)], extend=0.5, model="slerp").duration_seconds
    4.5
    """
    loaded = load_motion(motion)
    if isinstance(extend, str) or extend is None:
        before, after = parse_extend(extend or "0")
    else:
        before, after = map(float, extend if isinstance(extend, tuple) else (0.0, extend))
    if isinstance(keep, str):
        keep = parse_keep(keep)
    request = CompletionRequest(None if fps is None else parse_fps(fps), keep, before, after, plant)
    chosen = choose_encoder(model, None if run is None else str(run), default_path("runs"))
    completed = completed_motion(loaded, request, chosen)
    for warning in completed.warnings:
        warn(warning)
    return completed.motion


@dataclass(frozen=True, eq=False)
class CompletionRequest:
    """What to complete: `fps` None is the motion's own, `keep` None keeps every valid frame.

    `before_seconds` and `after_seconds` extend it; `plant` removes foot sliding from new frames. Raises `UsageError`
    where there is nothing to do, and for seconds outside 0 … 60.
    """

    fps: Fraction | None = None
    keep: Sequence[FrameRange] | Frames | None = None
    before_seconds: float = 0.0
    after_seconds: float = 0.0
    plant: bool = False

    def __post_init__(self) -> None:
        for seconds in (self.before_seconds, self.after_seconds):
            if not 0 <= seconds <= LONGEST_REACH_SECONDS:
                raise UsageError(
                    f"extend {seconds:g}: a motion is extended by at most {LONGEST_REACH_SECONDS:g} s, and not below 0"
                )
        if self.fps is None and self.keep is None and not (self.before_seconds or self.after_seconds or self.plant):
            raise UsageError(
                "nothing to complete: give fps (120), the frames to keep (0:10,40:50), or the seconds to extend it by "
                "(0.5,1)"
            )


def completed_motion(loaded: LoadedMotion, request: CompletionRequest, chosen: ChosenEncoder) -> EditedMotion:
    """The motion, completed by an encoder.

    Raises `MotionkitError` for a lower framerate, frames that it does not have, and where the encoder fails.
    """
    motion = loaded.motion
    fps, observed = request.fps or motion.fps, observed_frames(loaded, request)
    before, after = request.before_seconds, request.after_seconds
    if motion.num_frames == 1 and not (before or after):
        raise MotionkitError("it has a single frame, so there is nothing between frames; it can only be extended")
    encoder, replaced = chosen.for_skeleton(motion.skeleton)
    observation, known = loaded.observation(observed), np.flatnonzero(observed)
    span = (float(loaded.seconds[0]), float(loaded.seconds[-1]))
    try:
        completion = begin_completion(observation, span, encoder, fps, before_seconds=before, after_seconds=after)
    except ValueError as error:
        raise MotionkitError(f"{chosen.name} cannot complete it: {error}") from None
    field = completion.field
    if request.plant:
        field = anchored(planted(field), observation)
    if observation.poses.local_rotations is not None:
        field = on_bones(field, observation)
    completed, num_given = replace(completion, field=field).motion(), len(completion.given_rows)
    line = (
        f"complete {motion.num_frames} frames at {motion.fps} fps -> {completed.num_frames} at {completed.fps}, "
        f"{completed.num_frames - num_given} made"
    )
    completed = completed.annotated_like(motion).logged(line)
    frames = KnownFrames(known, observation.times_seconds, completion.given_rows, known[completion.given_poses])
    gap = float(np.diff(loaded.seconds[observed]).max(initial=0.0))
    warnings = [replaced] if replaced else _warnings(chosen, gap, max(before, after), len(known))
    if not loaded.valid.all():
        warnings.append(f"{int((~loaded.valid).sum()):,} frames hold nan and were filled like gaps")
    details = {
        "encoder": encoder.name if replaced else chosen.name,
        "fps": str(motion.fps),
        "completed_fps": str(completed.fps),
        "num_frames": motion.num_frames,
        "num_completed_frames": completed.num_frames,
        "num_given_frames": num_given,
        "num_made_frames": completed.num_frames - num_given,
        "longest_gap_seconds": gap,
    }
    return EditedMotion(completed, partial(write_as_loaded, loaded, completed, frames), details, warnings)


def observed_frames(loaded: LoadedMotion, request: CompletionRequest) -> Frames:
    """A mask of the valid frames to keep; raises `MotionkitError` for a framerate or frames that it cannot have."""
    own = loaded.motion.fps
    if loaded.uneven_seconds is not None and request.fps is None:
        raise MotionkitError(
            f"its frames are uneven in time, about {float(own):.4g} a second: give the fps of the result"
        )
    if request.fps is not None and request.fps < own:
        fps = str(request.fps)
        raise MotionkitError(
            f"{fps} fps is less than its {own}: frames would be dropped, not made; filter it down instead: "
            f"motionkit convert --fps {fps}, in Python motion.resample({fps})"
        )
    observed = np.asarray(loaded.valid & kept_frames(request.keep, loaded.motion.num_frames))
    if not observed.any():
        raise MotionkitError("no frame to keep is valid: keep at least one that holds no nan")
    return observed


def _warnings(chosen: ChosenEncoder, gap: float, reach: float, num_known: int) -> list[str]:
    warnings = []
    if gap > chosen.longest_gap_seconds + 1e-6:
        warnings.append(
            f"a gap of {gap:.2f} s is longer than the {chosen.longest_gap_seconds:.2f} s that {chosen.name} has learnt "
            "to close"
        )
    if chosen.supports_continuation and reach > LONGEST_PLAUSIBLE_SECONDS:
        warnings.append(
            f"{chosen.name} goes on at constant velocity for {reach:g} s; beyond {LONGEST_PLAUSIBLE_SECONDS:g} s that "
            "is unrealistic (the model spline comes to rest)"
        )
    if reach > chosen.reach_seconds + 1e-6:
        warnings.append(
            f"{reach:g} s beyond an end is farther than the {chosen.reach_seconds:.2f} s that {chosen.name} has learnt"
        )
    if num_known == 1:
        warnings.append("one frame is known, so the body stands still in it")
    return warnings


def kept_frames(keep: Sequence[FrameRange] | Frames | None, num_frames: int) -> Frames:
    """A mask of the frames to keep; raises `MotionkitError` for a range outside the motion, `UsageError` for a mask."""
    if isinstance(keep, np.ndarray):
        if keep.dtype != np.bool_ or keep.shape != (num_frames,):
            raise UsageError(f"keep is a mask of {len(keep):,} frames, the motion has {num_frames:,}")
        return keep
    kept = np.full(num_frames, keep is None)
    for start, stop in keep or ():
        end = num_frames if stop is None else stop
        if not 0 <= start < end <= num_frames:
            shown = f"{start}:{'' if stop is None else stop}"
            raise MotionkitError(f"keep {shown} is no range inside its {num_frames} frames, 0:{num_frames}")
        kept[start:end] = True
    return kept


def parse_keep(text: str) -> tuple[FrameRange, ...]:
    """Parse ranges of frames such as `0:10,40:50`, half-open and counted from 0; also `:10`, `40:` and a single `7`.

    Raises `UsageError` for anything else.
    """
    ranges: list[FrameRange] = []
    for field in text.split(","):
        match = _RANGE.fullmatch(field.strip())
        if match is None or not (match["start"] or match["colon"]) or len(field) > 40:
            raise UsageError(f"keep: {field.strip()[:40]!r} is not a range of frames such as 0:10, 40: or 7")
        start = int(match["start"] or 0)
        stop = (int(match["stop"]) if match["stop"] else None) if match["colon"] else start + 1
        ranges.append((start, stop))
    return tuple(ranges)


def parse_extend(text: str) -> tuple[float, float]:
    """Parse the seconds before and after, `0.5,1`; a single number is after. Raises `UsageError`."""
    try:
        before, after = map(float, (text if "," in text else f"0,{text}").split(","))
    except ValueError:
        raise UsageError(f"extend {text}: expected seconds, AFTER or BEFORE,AFTER (0.5,1)") from None
    return before, after
