"""Plants one clip: removes foot sliding, writes it in its format, optionally with a page of both, and reports."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import MotionkitError
from motionkit.core.files import whole_file
from motionkit.core.framerate import format_fps
from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool
from motionkit.core.timegrid import TimeGrid, num_frames_within
from motionkit.edit.complete.clips import Clip, ClipSource, Progress, as_format
from motionkit.edit.complete.job import PAGE_BYTES, PAGE_SECONDS, OutputPath
from motionkit.edit.plant.report import Change, measure_change
from motionkit.fields.completion import Completion
from motionkit.fields.contact.correction import Path as BodyPath
from motionkit.fields.contact.planted import PlantedField, planted, planted_frames
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.viz.player.page import write_page
from motionkit.viz.player.takes import Take, packed_bytes, take_of


@dataclass(frozen=True)
class PlantedClip:
    """The result for a clip: its file, the change, the page, a note."""

    source: str
    path: Path
    fps: str
    num_frames: int
    change: Change
    page: Path | None
    note: str = ""

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "clip": self.source,
            "file": str(self.path),
            "fps": self.fps,
            "num_frames": self.num_frames,
            **self.change.plain(),
            "page": None if self.page is None else str(self.page),
            "note": self.note,
        }


@dataclass(frozen=True)
class Job:
    """Options for every clip: the body's path, whether to write a page, the output format."""

    path: BodyPath = "near"
    page: bool = False
    suffix: str | None = None
    overwrite: bool = False

    def plant(self, source: ClipSource, path_of: OutputPath, progress: Progress) -> PlantedClip:
        """Read, plant and write one clip; raises `MotionkitError` or `OSError` without leaving files behind."""
        clip = source.read()
        if self.suffix is not None:
            clip = as_format(clip, self.suffix)
        path = path_of(source, clip.suffix, format_fps(clip.timegrid.fps))
        page = path.with_suffix(".html") if self.page else None
        for each in (path, page):
            if each is not None and each.exists() and not self.overwrite:
                raise MotionkitError(f"{each} exists: --overwrite replaces it, --out writes elsewhere")
        made, change, moved = plant_clip(clip, self.path, progress)
        with whole_file(path) as temporary:
            clip.write(made, temporary, lambda _: None)
            if page is not None:
                write_before_and_after(page, source.name, clip, made, moved)
        return PlantedClip(
            source.name, path, format_fps(clip.timegrid.fps), clip.timegrid.num_frames, change, page, clip.note
        )


def plant_clip(
    clip: Clip, path: BodyPath, progress: Progress = lambda _: None
) -> tuple[Completion, Change, Bool[np.ndarray, "frames"]]:
    """The planted clip, ready to be written, the change, and a mask of changed frames; raises `MotionkitError`.

    Unchanged frames are identical to the clip's.
    """
    if not clip.seen.all():
        raise MotionkitError(
            f"{int((~clip.seen).sum()):,} of its {clip.timegrid.num_frames:,} frames hold nan: complete it first"
        )
    observation, grid = clip.observe(clip.seen), clip.timegrid
    field: PlantedField
    if clip.uneven_seconds is None:
        field = planted_frames(observation, grid, path)
    else:
        field = planted(INTERPOLATORS["slerp"].encode(observation), path)
    change, moved = measure_change(field, clip.seconds, progress)
    unmoved = np.flatnonzero(~moved)
    known = np.arange(grid.num_frames)
    if clip.uneven_seconds is not None:
        grid, unmoved = TimeGrid(grid.fps, grid.num_frames, float(clip.seconds[0])), unmoved[:0]
    made = Completion(observation, known, field, grid, unmoved, unmoved, planted_line(path, change))
    return made, change, moved


def planted_line(path: BodyPath, change: Change) -> str:
    """The operation log's line for a planted motion."""
    return (
        f"plant {change.num_contacts} contacts, the body's path {path}: joints moved by up to "
        f"{1000 * change.largest_change:.1f} mm"
    )


def write_before_and_after(
    path: Path, title: str, clip: Clip, made: Completion, moved: Bool[np.ndarray, "frames"]
) -> None:
    """Write the page of a clip before and after planting, atomically."""
    grid, joints = clip.timegrid, clip.skeleton.num_joints
    shown = min(grid.num_frames, num_frames_within(PAGE_SECONDS, grid.fps), PAGE_BYTES // packed_bytes(1, joints))
    before = clip.label(clip.poses(np.arange(shown)).at(TimeGrid(grid.fps, shown, grid.start_seconds), clip.skeleton))
    after = made.motion(0, shown)
    part = "" if shown == grid.num_frames else f"Shown: the first {float(shown / grid.fps):.4g} seconds. "
    takes = [
        replace(take_of(before, "before"), colours="plain"),
        replace(_after(after), seen=~moved[:shown]),
    ]
    write_page(
        path, title, takes, note=f"{part}Dark are frames that stayed, orange are those that moved.", one_camera=True
    )


def _after(motion: Motion) -> Take:
    return Take(
        "planted",
        motion.joint_positions,
        motion.skeleton,
        motion.fps,
        motion.timegrid.start_seconds,
        unseen="moved",
        colours="given",
    )
