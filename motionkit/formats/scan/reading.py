"""Reading one sequence that a scan found: its file, its framerate corrected, its stretch, its mirror image."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.core.mirror import mirror
from motionkit.core.motion import Motion
from motionkit.core.skeletons.families import with_layout_map
from motionkit.formats.catalogue import FORMATS
from motionkit.formats.scan import cuts, framerate_rules
from motionkit.formats.scan.items import ReadOptions, SourceItem
from motionkit.formats.source.sizes import check_size

# Reasons for which a file is refused where only its framerate is missing or unusable.
NO_FRAMERATE = frozenset({"no-framerate", "framerate", "frame-time"})


def read(item: SourceItem, options: ReadOptions | None = None) -> Motion:
    """Read one sequence with its annotations; raises `FormatError`, `too-large` for more than a store takes."""
    options = options or ReadOptions()
    if options.fps is None and item.fps is not None:
        options = replace(options, fps=item.fps)
    if item.cut is None and not item.mirrored:
        motion = _read_file(item, options)
        motion = replace(motion, captions=item.captions or motion.captions)
    else:
        motion = _read_stretch(item, options)
    check_size(motion.num_frames, motion.skeleton.num_joints, item.path)
    provenance = replace(
        motion.provenance,
        source=item.source,
        subset=item.subset,
        source_path=item.path.relative_to(item.root).as_posix(),
        licence=item.licence or motion.provenance.licence,
        subject=item.subject or motion.provenance.subject,
        stated_fps=item.stated_fps or motion.provenance.stated_fps,
    )
    return replace(
        motion,
        skeleton=with_layout_map(motion.skeleton, options.skeleton_maps),
        sequence_id=item.sequence_id,
        action=item.action or motion.action,
        style=item.style or motion.style,
        split=item.split or motion.split,
        provenance=provenance,
    )


def _read_file(item: SourceItem, options: ReadOptions) -> Motion:
    # All of a file, its framerate corrected by a rule unless the user has given one.
    if options.fps is not None:
        return FORMATS[item.format].read(item, options)
    rules = framerate_rules.matching_rules(item.path, item.root, (*options.fps_rules, *framerate_rules.shipped_rules()))
    try:
        motion = FORMATS[item.format].read(item, options)
    except FormatError as problem:
        rule = next((rule for rule in rules if rule.stated is None), None)
        if rule is None or problem.reason not in NO_FRAMERATE:
            raise
        motion = FORMATS[item.format].read(item, replace(options, fps=rule.fps))
        return motion.logged(f"framerate by rule ({rule.where})")
    return framerate_rules.corrected(motion, rules)


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
    # The stretches of a file follow each other, and reading a file costs far more than cutting it. A file that has
    # changed since is read again.
    return _read_file(whole, options)


def _version(path: Path) -> tuple[int, int]:
    try:
        status = path.stat()
    except OSError:
        return 0, 0  # the reader will say so
    return status.st_mtime_ns, status.st_size
