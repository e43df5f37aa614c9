"""Completes one clip: encodes it, writes it in its format, optionally with a page of comparisons, and reports."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import MotionkitError
from motionkit.core.files import whole_file
from motionkit.core.framerate import format_fps
from motionkit.core.shapes import Bool
from motionkit.core.timegrid import TimeGrid, num_frames_within
from motionkit.edit.complete.clips import Clip, ClipSource, Progress, as_format
from motionkit.edit.complete.encoders import ChosenEncoder
from motionkit.edit.complete.request import ClipRequest, CompletionRequest
from motionkit.edit.export.files import names_a_file
from motionkit.fields.anchoring import anchored
from motionkit.fields.completion import Completion, begin_observed, begin_uneven
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import MotionEncoder
from motionkit.io.scan import COMPLETED, derived_folder
from motionkit.viz.player.page import write_page
from motionkit.viz.player.takes import Take, packed_bytes, take_of

# Extrapolation at constant velocity is implausible beyond this.
LONGEST_PLAUSIBLE_SECONDS = 0.5
# What is looked at; and a page of some megabytes opens at once, whatever the framerate.
PAGE_SECONDS, PAGE_BYTES = 60.0, 24_000_000


@dataclass(frozen=True)
class CompletedClip:
    """The result for a clip: its file, encoder, numbers of given and new frames, and warnings."""

    source: str
    path: Path
    encoder: str
    fps: str
    completed_fps: str
    num_frames: int
    num_completed: int
    num_given: int
    longest_gap_seconds: float
    page: Path | None
    warnings: tuple[str, ...]

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "clip": self.source,
            "file": str(self.path),
            "encoder": self.encoder,
            "fps": self.fps,
            "completed_fps": self.completed_fps,
            "num_frames": self.num_frames,
            "num_completed_frames": self.num_completed,
            "num_given_frames": self.num_given,
            "num_made_frames": self.num_completed - self.num_given,
            "longest_gap_seconds": self.longest_gap_seconds,
            "page": None if self.page is None else str(self.page),
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True)
class Job:
    """Options for every clip: the request, the encoder, encoders to compare with, the output format."""

    request: CompletionRequest
    chosen: ChosenEncoder
    compared: Sequence[ChosenEncoder] = ()
    suffix: str | None = None
    overwrite: bool = False

    def complete(self, source: ClipSource, path_of: "OutputPath", progress: Progress) -> CompletedClip:
        """Read, complete and write one clip; raises `MotionkitError` or `OSError` without leaving files behind."""
        clip = source.read()
        if self.suffix is not None:
            clip = as_format(clip, self.suffix)
        wanted = self.request.for_clip(clip.timegrid, clip.seen, clip.uneven_seconds)
        path = path_of(source, clip.suffix, format_fps(wanted.fps))
        page = path.with_suffix(".html") if self.compared else None
        for each in (path, page):
            if each is not None and each.exists() and not self.overwrite:
                raise MotionkitError(f"{each} exists: --overwrite replaces it, --out writes elsewhere")
        made, name, warnings = begin_clip(clip, wanted, self.chosen)
        with whole_file(path) as temporary:
            clip.write(made, temporary, progress)
            if page is not None:
                others = [(other.name, begin_clip(clip, wanted, other)[0]) for other in self.compared]
                write_comparison(page, source.name, clip, wanted.observed, [(name, made), *others])
        if clip.note:
            warnings.append(clip.note)
        return CompletedClip(
            source=source.name,
            path=path,
            encoder=name,
            fps=format_fps(clip.timegrid.fps),
            completed_fps=format_fps(wanted.fps),
            num_frames=clip.timegrid.num_frames,
            num_completed=made.grid.num_frames,
            num_given=len(made.given_rows),
            longest_gap_seconds=wanted.longest_gap_seconds,
            page=page,
            warnings=tuple(warnings),
        )


def begin_clip(clip: Clip, wanted: ClipRequest, chosen: ChosenEncoder) -> tuple[Completion, str, list[str]]:
    """A clip's completion, ready to be sampled; the name of its encoder; warnings.

    Raises `MotionkitError` if the encoder fails.
    """
    encoder, warning = chosen.for_skeleton(clip.skeleton)
    name = encoder.name if warning else chosen.name
    warnings = [warning] if warning else _warnings(clip, wanted, chosen)
    try:
        made = _encoded(clip, wanted, encoder)
    except ValueError as error:
        raise MotionkitError(f"{chosen.name} cannot complete it: {error}") from None
    if wanted.plant:
        made = replace(made, field=anchored(planted(made.field), made.observation))
    lost = int((~clip.seen).sum())
    if lost:
        warnings.append(f"{lost:,} frames hold nan and were filled like gaps")
    return made, name, warnings


def _encoded(clip: Clip, wanted: ClipRequest, encoder: MotionEncoder) -> Completion:
    observation, known = clip.observe(wanted.observed), np.flatnonzero(wanted.observed)
    reach = {"before_seconds": wanted.before_seconds, "after_seconds": wanted.after_seconds}
    if clip.uneven_seconds is None:
        return begin_observed(observation, known, clip.timegrid, encoder, wanted.fps, **reach)
    span = (float(clip.uneven_seconds[0]), float(clip.uneven_seconds[-1]))
    return begin_uneven(observation, known, span, encoder, wanted.fps, **reach)


def _warnings(clip: Clip, wanted: ClipRequest, chosen: ChosenEncoder) -> list[str]:
    found = []
    gap, longest = wanted.longest_gap_seconds, chosen.longest_gap_seconds
    if longest is not None and gap > longest + 1e-6:
        found.append(f"a gap of {gap:.2f} s is longer than the {longest:.2f} s that {chosen.name} has learnt to close")
    reach = max(wanted.before_seconds, wanted.after_seconds)
    if chosen.supports_continuation and reach > LONGEST_PLAUSIBLE_SECONDS:
        found.append(
            f"{chosen.name} goes on at constant velocity for {reach:g} s; beyond {LONGEST_PLAUSIBLE_SECONDS:g} s that "
            "is unrealistic (the model spline comes to rest)"
        )
    trained = chosen.reach_seconds
    if trained is not None and reach > trained + 1e-6:
        found.append(f"{reach:g} s beyond an end is farther than the {trained:.2f} s that {chosen.name} has learnt")
    if int(wanted.observed.sum()) == 1:
        found.append("one frame is known, so the body stands still in it")
    return found


class OutputPath:
    """Chooses a unique output file for each clip."""

    def __init__(self, out: Path | None, num_clips: int, folders: Sequence[Path], made: str = COMPLETED) -> None:
        self._out = out
        self._is_file = names_a_file(out) and num_clips == 1 and not folders
        self._folders = folders
        self._made = made
        self._taken: dict[Path, str] = {}

    def __call__(self, source: ClipSource, suffix: str, fps: str) -> Path:
        """The file of a clip: `--out`, or in `--out`, or beside it with `made` before the suffix."""
        path = self._path(source, suffix, fps)
        other = self._taken.setdefault(path.absolute(), source.name)
        if other != source.name:
            raise MotionkitError(f"its result would be {path}, as that of {other}: name them one by one with --out")
        return path

    def _path(self, source: ClipSource, suffix: str, fps: str) -> Path:
        stem = source.beside.name
        named = next((folder for folder in self._folders if source.beside.is_relative_to(folder)), None)
        if self._out is None:
            # A motions.json states the framerate of all arrays beside it, so new ones need their own folder.
            beside = source.beside.parent
            folder = beside / derived_folder(fps, self._made) if suffix == ".npy" else beside
            return folder / (f"{stem}.npy" if suffix == ".npy" else f"{stem}.{self._made}{suffix}")
        if self._is_file:
            return self._out
        return self._out / (source.beside.relative_to(named).parent if named else "") / f"{stem}{suffix}"


def write_comparison(
    path: Path,
    title: str,
    clip: Clip,
    observed: Bool[np.ndarray, "frames"],
    ways: Sequence[tuple[str, Completion]],
) -> None:
    """Write a page of a clip and its completions by name, atomically, each at its own framerate.

    Raises `MotionkitError`.
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
