"""A page with a motion and what was made of it, side by side on one clock: for `complete --compare` and `plant`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool
from motionkit.core.timegrid import num_frames_within
from motionkit.viz.player import Panel, packed_bytes, panel_of, write_page

# What is looked at; and a page of some megabytes opens at once, whatever the framerate.
PAGE_SECONDS, PAGE_BYTES = 60.0, 24_000_000


@dataclass(frozen=True, eq=False)
class Version:
    """A motion that was made of another, its name, and a mask of the frames that are those of the other."""

    name: str
    motion: Motion
    given: Bool[np.ndarray, "frames"]


def write_comparison(
    path: Path, title: str, source: Panel, versions: Sequence[Version], *, others: str, note: str
) -> None:
    """Write a page of a motion and its versions, atomically, each at its own framerate; of long ones the beginning.

    `others` labels frames that are not given. Raises `MotionkitError` for joints that are NaN or too far away.
    """
    first = versions[0].motion
    frame_bytes = packed_bytes(1, source.skeleton.num_joints) * len(versions)
    num_shown = min(first.num_frames, num_frames_within(PAGE_SECONDS, first.fps), max(1, PAGE_BYTES // frame_bytes))
    shown_seconds = float(num_shown / first.fps)
    until = first.timegrid.start_seconds + shown_seconds
    of_source = max(1, int(np.searchsorted(source.frame_seconds(), until - 1e-6)))
    panels = [replace(source.frames(0, of_source), colours="plain")]
    for version in versions:
        panel = panel_of(version.motion, version.name)
        panel = replace(panel, observed=version.given, gap_label=others, colours="given")
        panels.append(panel.frames(0, num_shown))
    if num_shown < first.num_frames:
        note = f"Shown: the first {shown_seconds:.4g} of {first.duration_seconds:.1f} seconds. {note}"
    write_page(path, title, panels, note=note, one_camera=True)
