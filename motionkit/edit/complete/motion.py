"""`motionkit.edit.complete`: as the command, for a motion in memory."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.framerate import Framerate, parse_fps
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.core.settings import default_path
from motionkit.core.shapes import Bool
from motionkit.edit.complete.clips import Clip, clip_of_motion, completed_line, find_clips
from motionkit.edit.complete.encoders import choose_encoder
from motionkit.edit.complete.job import begin_clip
from motionkit.edit.complete.request import CompletionRequest, FrameRange, Reach, parse_extend, parse_keep
from motionkit.fields.rig import on_bones
from motionkit.io.registry import ReadOptions
from motionkit.store.named_motions.reading import existing_path

Kept = str | Sequence[tuple[int, int | None]] | Bool[np.ndarray, "frames"]
Seconds = int | float
Extension = str | Seconds | tuple[Seconds, Seconds]


def complete(
    motion: Motion | str | Path,
    *,
    fps: Framerate | None = None,
    keep: Kept | None = None,
    extend: Extension | None = None,
    plant: bool = False,
    model: str | None = None,
    run: str | Path | None = None,
) -> Motion:
    """A motion with more frames, gaps filled, ends continued; given frames and bone lengths are kept.

    - `motion`: a motion, or a file; frames of a file that hold nan are filled like gaps
    - `fps`: the new framerate, not below its own (`resample` filters it down)
    - `keep`: the frames to keep, all others are replaced: `[(0, 10), (40, None)]`, half-open and counted from 0, or
      "0:10,40:", or a mask of one bool for each frame
    - `extend`: seconds to add after it; or a pair, before and after; or "0,15f" in frames
    - `plant`: whether to remove foot sliding from the new frames (`motionkit.edit.plant` is for a whole motion)
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
    clip = clip_of(motion)
    before, after = _reaches(extend)
    request = CompletionRequest(
        fps=None if fps is None else parse_fps(fps),
        keep=_ranges(keep, clip.timegrid.num_frames),
        before=before,
        after=after,
        plant=plant,
    )
    wanted = request.for_clip(clip.timegrid, clip.seen, clip.uneven_seconds)
    chosen = choose_encoder(model, None if run is None else str(run), default_path("runs"))
    completion, _, remarks = begin_clip(clip, wanted, chosen)
    for remark in remarks:
        warn(remark)
    if completion.observation.rows(slice(0, 1)).poses.local_rotations is not None:
        completion = replace(completion, field=on_bones(completion.field, completion.observation))
    made = completion.motion(0, completion.grid.num_frames)
    return clip.label(made).logged(completed_line(completion, clip.timegrid))


def clip_of(motion: Motion | str | Path) -> Clip:
    """The clip of a motion or a file; raises what reading it raises, and `UsageError` for a file with several."""
    if isinstance(motion, Motion):
        return clip_of_motion(motion)
    path = existing_path(motion)
    found, problems = find_clips([str(path)], ReadOptions(), path)
    if not found:
        raise problems[0]
    if len(found) > 1:
        raise UsageError(f"{path} holds {len(found):,} motions: take them one by one, read_all(path) gives them")
    return found[0].read()


def _ranges(keep: Kept | None, num_frames: int) -> tuple[FrameRange, ...]:
    if keep is None:
        return ()
    if isinstance(keep, str):
        return parse_keep(keep)
    if isinstance(keep, np.ndarray):
        if len(keep) != num_frames:
            raise UsageError(f"keep is a mask of {len(keep):,} frames, the motion has {num_frames:,}")
        bounds = np.flatnonzero(np.diff(keep, prepend=False, append=False)).reshape(-1, 2)
        keep = [(first, stop) for first, stop in bounds.tolist()]
    if not len(keep):
        raise UsageError("keep is empty: keep at least one frame")
    return parse_keep(",".join(f"{start}:{'' if stop is None else stop}" for start, stop in keep))


def _reaches(extend: Extension | None) -> tuple[Reach, Reach]:
    if extend is None:
        return Reach(0.0), Reach(0.0)
    if isinstance(extend, str):
        return parse_extend(extend)
    before, after = extend if isinstance(extend, tuple) else (0.0, extend)
    return parse_extend(f"{before},{after}")
