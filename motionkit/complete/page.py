"""The page of `--compare`: the clip as it was, completed, and completed in other ways, side by side."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from motionkit.complete.clips import Clip
from motionkit.core.timegrid import TimeGrid, format_fps, num_frames_within
from motionkit.export.player.page import write_page
from motionkit.export.player.takes import Take, packed_bytes, take_of
from motionkit.fields.completion import Completion

# What is looked at; and a page of some megabytes opens at once, whatever the framerate.
PAGE_SECONDS, PAGE_BYTES = 60.0, 24_000_000


def write_comparison(
    path: Path,
    title: str,
    clip: Clip,
    observed: Bool[np.ndarray, "frames"],
    ways: Sequence[tuple[str, Completion]],
) -> None:
    """Write the page of a clip and of one or more completions of it, by name; it appears whole or not at all.

    Each has its own frames: the clip those that it came with, a completion those of its framerate. Raises
    `MotionkitError`.
    """
    grid = ways[0][1].grid
    frame_bytes = packed_bytes(1, clip.skeleton.num_joints) * len(ways)
    num_shown = min(grid.num_frames, num_frames_within(PAGE_SECONDS, grid.fps), max(1, PAGE_BYTES // frame_bytes))
    shown_seconds = float(num_shown / grid.fps)
    takes = [_as_it_was(clip, observed, grid.start_seconds + shown_seconds), *(_made(*way, num_shown) for way in ways)]
    whole = num_shown == grid.num_frames
    part = "" if whole else f"Shown: the first {shown_seconds:.4g} of {grid.duration_seconds:.1f} seconds. "
    note = f"{part}Dark are frames that were given, orange are those that were made."
    write_page(path, title, takes, note=note, one_camera=True)


def _as_it_was(clip: Clip, observed: Bool[np.ndarray, "frames"], until_seconds: float) -> Take:
    count = max(1, int(np.searchsorted(clip.seconds, until_seconds - 1e-6)))
    grid = TimeGrid(clip.timegrid.fps, count, float(clip.seconds[0]))
    motion = clip.label(clip.poses(np.arange(count)).at(grid, clip.skeleton))
    return replace(
        take_of(motion, "the clip"),
        uneven_seconds=None if clip.uneven_seconds is None else clip.uneven_seconds[:count],
        seen=None if observed[:count].all() else observed[:count],
        unseen="left out",
        colours="plain",
    )


def _made(name: str, completion: Completion, num_shown: int) -> Take:
    motion = completion.motion(0, num_shown)
    given = np.zeros(num_shown, bool)
    given[completion.given_rows[completion.given_rows < num_shown]] = True
    return Take(
        name=name,
        joint_positions=motion.joint_positions,
        skeleton=motion.skeleton,
        fps=motion.fps,
        start_seconds=motion.timegrid.start_seconds,
        seen=given,
        unseen="made",
        colours="given",
        details=(("framerate", f"{format_fps(motion.fps)} fps"),),
    )
