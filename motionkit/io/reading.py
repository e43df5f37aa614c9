"""Reading a sequence found by a scan: its file, with the framerate corrected, cropped and mirrored as required."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from motionkit.core.errors import FormatError
from motionkit.core.mirror import mirror
from motionkit.core.motion import Caption, Motion, captions_within
from motionkit.core.skeletons.families import with_layout_map
from motionkit.core.timegrid import TimeGrid
from motionkit.io import cuts, framerate_rules
from motionkit.io.body_frame import check_unit, log_lines, turned
from motionkit.io.bvh import BvhDocument
from motionkit.io.registry import ReadOptions, SourceItem, reader_of
from motionkit.io.source_file import check_size

# Reasons for refusing a file that lacks only a usable framerate.
NO_FRAMERATE = frozenset({"no-framerate", "framerate", "frame-time"})


Read = TypeVar("Read", Motion, BvhDocument)


def read(item: SourceItem, options: ReadOptions | None = None) -> Motion:
    """Read one sequence with its annotations; raises `FormatError`, `too-large` beyond a store's limit."""
    options = _with_clock(item, options)
    if item.cut is None and not item.mirrored:
        motion = _read_file(item, options)
        motion = replace(motion, captions=item.captions or motion.captions)
        motion = _without_first(motion, item, options)
    else:
        motion = _read_stretch(item, options)
    check_unit(motion.skeleton, motion.joint_positions[:1], options.unit_metres, item.path)
    check_size(motion.num_frames, motion.skeleton.num_joints, item.path)
    return _annotated(motion, item, options)


def read_document(item: SourceItem, options: ReadOptions | None = None) -> BvhDocument | None:
    """The document of a whole file with its annotations, None if its format has none.

    Its motion is that of `read`. Raises `FormatError`.
    """
    options, document = _with_clock(item, options), reader_of(item.format).document
    if document is None:
        return None
    found: BvhDocument = _on_clock(item, options, lambda changed: document(item.path, changed))
    check_unit(found.motion.skeleton, found.motion.joint_positions[:1], options.unit_metres, item.path)
    found = _changed(found, lambda motion: replace(motion, captions=item.captions))
    return _annotated(_without_first(found, item, options), item, options)


def _changed(made: Read, change: Callable[[Motion], Motion]) -> Read:
    """A changed motion, or a document with its motion changed."""
    return change(made) if isinstance(made, Motion) else replace(made, motion=change(made.motion))


def _without_first(made: Read, item: SourceItem, options: ReadOptions) -> Read:
    """The motion without its first frames, its clock starting at 0; raises `FormatError` if no frame is left.

    Captions, whose seconds count from the file's first frame, move with it; those of the left-out frames are dropped.
    """
    num_frames = options.skip_frames if item.skip_frames is None else item.skip_frames
    motion = made if isinstance(made, Motion) else made.motion
    if num_frames == 0:
        return made
    if num_frames >= motion.num_frames:
        message = f"{motion.num_frames} frames, of which the first {num_frames} are to be left out"
        raise FormatError(message, path=item.path, reason="skip-frames")
    line = f"the first {num_frames} of {motion.num_frames} frames left out (skip_frames)"

    def from_zero(kept: Motion) -> Motion:
        captions = _earlier(captions_within(kept.captions, kept.timegrid), float(num_frames / kept.fps))
        return replace(kept, timegrid=TimeGrid(kept.fps, kept.num_frames), captions=captions).logged(line)

    return _changed(made.frames(num_frames, motion.num_frames), from_zero)


def _earlier(captions: tuple[Caption, ...], seconds: float) -> tuple[Caption, ...]:
    return tuple(
        replace(
            caption,
            start_seconds=max(0.0, caption.start_seconds - seconds),
            end_seconds=None if caption.end_seconds is None else caption.end_seconds - seconds,
        )
        for caption in captions
    )


def _with_clock(item: SourceItem, options: ReadOptions | None) -> ReadOptions:
    options = options or ReadOptions()
    return replace(options, fps=item.fps) if options.fps is None else options


def _annotated(made: Read, item: SourceItem, options: ReadOptions) -> Read:
    return _changed(made, lambda motion: _annotated_motion(motion, item, options))


def _annotated_motion(made: Motion, item: SourceItem, options: ReadOptions) -> Motion:
    provenance = replace(
        made.provenance,
        source=item.source,
        subset=item.subset,
        source_path=item.path.relative_to(item.root).as_posix(),
        licence=item.licence or made.provenance.licence,
        subject=item.subject or made.provenance.subject,
        stated_fps=item.stated_fps or made.provenance.stated_fps,
    )
    return replace(
        made,
        skeleton=with_layout_map(made.skeleton, options.skeleton_maps),
        sequence_id=item.sequence_id,
        action=item.action or made.action,
        style=item.style or made.style,
        split=item.split or made.split,
        provenance=provenance,
    )


def _read_file(item: SourceItem, options: ReadOptions) -> Motion:
    read_with = reader_of(item.format).read
    assert read_with is not None
    motion = _on_clock(item, options, lambda wanted: read_with(item, wanted))
    if not options.up or reader_of(item.format).turns_up:
        return motion
    motion = turned(motion, options.up)
    for line in log_lines(options.up, options.up):
        motion = motion.logged(line)
    return motion


def _on_clock(item: SourceItem, options: ReadOptions, read: Callable[[ReadOptions], Read]) -> Read:
    # The whole file, its framerate corrected by a rule unless the user has given one.
    if options.fps is not None:
        return read(options)
    rules = framerate_rules.matching_rules(item.path, item.root, (*options.fps_rules, *framerate_rules.shipped_rules()))
    try:
        made = read(options)
    except FormatError as problem:
        rule = next((rule for rule in rules if rule.stated is None), None)
        if rule is None or problem.reason not in NO_FRAMERATE:
            raise
        line = f"framerate by rule ({rule.where})"
        return _changed(read(replace(options, fps=rule.fps)), lambda motion: motion.logged(line))
    return _changed(made, lambda motion: _corrected(motion, rules))


def _corrected(motion: Motion, rules: tuple[framerate_rules.FramerateRule, ...]) -> Motion:
    fps, lines = framerate_rules.corrected_fps(motion.fps, rules)
    for line in lines:
        motion = replace(motion, timegrid=replace(motion.timegrid, fps=fps)).logged(line)
    return motion


def _read_stretch(item: SourceItem, options: ReadOptions) -> Motion:
    whole = SourceItem(item.format, item.path, item.root, sequence_id="", key=item.key, fps=item.fps)
    motion = _read_once(whole, options, _version(item.path))
    stated_fps = item.stated_fps or motion.provenance.stated_fps  # which frames an index counted depends on it
    provenance = replace(motion.provenance, stated_fps=stated_fps)
    captions = item.captions or motion.captions
    motion = replace(motion, captions=captions, provenance=provenance, sequence_id=item.sequence_id)
    if item.cut is not None:
        motion = cuts.crop(motion, item.cut, item.path)
    if not item.mirrored:
        return motion
    try:
        return mirror(motion)
    except ValueError as error:
        raise FormatError(f"cannot be mirrored: {error}", path=item.path, reason="mirror") from None


@lru_cache(maxsize=1)
def _read_once(whole: SourceItem, options: ReadOptions, version: tuple[int, int]) -> Motion:
    # The stretches of a file are consecutive, and reading it costs far more than cutting it. A file that has changed
    # since is read again.
    return _read_file(whole, options)


def _version(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except OSError:
        return 0, 0  # the reader will report it
    return status.st_mtime_ns, status.st_size
