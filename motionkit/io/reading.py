"""Reading a sequence found by a scan: its file, with the framerate corrected by rules, cropped, mirrored, annotated.

A rule corrects framerates that files state wrongly. It has globs of files (`pathlib.PurePath.match`), the wrong
framerate that they state (`stated`; omitted: any), the right one, and its source. The user's rules come first, and the
first matching rule applies; an explicit framerate (--fps, or the column fps of an annotation table) overrides all
rules. The shipped ones are framerate_rules.toml.
"""

from dataclasses import replace
from fractions import Fraction
from functools import cache, lru_cache
from importlib import resources
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from motionkit.core.errors import FormatError, UsageError, shown
from motionkit.core.files import LONGEST_TOML, parse_toml, read_at_most
from motionkit.core.mirror import mirror
from motionkit.core.motion import Motion, captions_within
from motionkit.core.skeletons.mapping import with_layout_map
from motionkit.core.timegrid import TimeGrid, parse_fps
from motionkit.io.body_frame import check_unit, log_lines, turned
from motionkit.io.cuts import crop
from motionkit.io.registry import FramerateRule, Reader, ReadOptions, SourceItem, reader_of
from motionkit.io.source_file import check_size

if TYPE_CHECKING:
    from motionkit.io.bvh import BvhDocument

# Reasons for refusing a file that lacks only a usable framerate.
NO_FRAMERATE = frozenset({"no-framerate", "framerate", "frame-time"})
RULE_KEYS = frozenset({"files", "stated", "fps", "reason", "source"})


def read(item: SourceItem, options: ReadOptions | None = None) -> Motion:
    """Read one sequence with its annotations; raises `FormatError`, `too-large` beyond a store's limit."""
    options = _with_fps(item, options)
    if item.cut is None and not item.mirrored:
        motion = _read_file(item, options)
        motion = _without_first(replace(motion, captions=item.captions or motion.captions), item, options)
    else:
        motion = _read_segment(item, options)
    return _annotated(motion, item, options)


def read_document(item: SourceItem, options: ReadOptions | None = None) -> "BvhDocument | None":
    """The document of a whole file with its annotations, None if its format has none.

    Its motion is that of `read`. Raises `FormatError`.
    """
    options, document_of = _with_fps(item, options), reader_of(item.format).document
    if document_of is None:
        return None
    documents: list[BvhDocument] = []

    def read_file(item: SourceItem, options: ReadOptions) -> Motion:
        documents.append(document_of(item.path, options))
        return documents[-1].motion

    motion = replace(_corrected(item, options, read_file), captions=item.captions)
    kept = _without_first(motion, item, options)
    document = documents[-1].frames(motion.num_frames - kept.num_frames, motion.num_frames)
    return replace(document, motion=_annotated(kept, item, options))


def _with_fps(item: SourceItem, options: ReadOptions | None) -> ReadOptions:
    options = options or ReadOptions()
    return replace(options, fps=item.fps) if options.fps is None else options


def _read_file(item: SourceItem, options: ReadOptions) -> Motion:
    kind = reader_of(item.format)
    assert kind.read is not None
    motion = _corrected(item, options, kind.read)
    if not options.up or kind.turns_up:
        return motion
    motion = turned(motion, options.up)
    for line in log_lines(options.up, options.up):
        motion = motion.logged(line)
    return motion


def _without_first(motion: Motion, item: SourceItem, options: ReadOptions) -> Motion:
    """The motion without its first frames, its clock starting at 0; raises `FormatError` if no frame is left.

    Captions, whose seconds count from the file's first frame, move with it; those of the left-out frames are dropped.
    """
    num_frames = options.skip_frames if item.skip_frames is None else item.skip_frames
    if num_frames == 0:
        return motion
    if num_frames >= motion.num_frames:
        message = f"{motion.num_frames} frames, of which the first {num_frames} are to be left out"
        raise FormatError(message, path=item.path, reason="skip-frames")
    kept = motion.frames(num_frames, motion.num_frames)
    seconds = float(num_frames / motion.fps)
    captions = tuple(
        replace(
            caption,
            start_seconds=max(0.0, caption.start_seconds - seconds),
            end_seconds=None if caption.end_seconds is None else caption.end_seconds - seconds,
        )
        for caption in captions_within(motion.captions, kept.timegrid)
    )
    line = f"the first {num_frames} of {motion.num_frames} frames left out (skip_frames)"
    return replace(kept, timegrid=TimeGrid(motion.fps, kept.num_frames), captions=captions).logged(line)


def _read_segment(item: SourceItem, options: ReadOptions) -> Motion:
    whole = SourceItem(item.format, item.path, item.root, sequence_id="", key=item.key, fps=item.fps)
    try:
        status = item.path.stat()
        version = status.st_mtime_ns, status.st_size
    except OSError:
        version = 0, 0  # the reader will report it
    motion = _read_once(whole, options, version)
    stated_fps = item.stated_fps or motion.provenance.stated_fps  # which frames an index counted depends on it
    provenance = replace(motion.provenance, stated_fps=stated_fps)
    captions = item.captions or motion.captions
    motion = replace(motion, captions=captions, provenance=provenance, sequence_id=item.sequence_id)
    if item.cut is not None:
        motion = crop(motion, item.cut, item.path)
    if not item.mirrored:
        return motion
    try:
        return mirror(motion)
    except ValueError as error:
        raise FormatError(f"cannot be mirrored: {error}", path=item.path, reason="mirror") from None


@lru_cache(maxsize=1)
def _read_once(whole: SourceItem, options: ReadOptions, version: tuple[int, int]) -> Motion:
    # The segments of a file are consecutive, and reading it costs far more than cutting it. A file that has changed
    # since is read again.
    return _read_file(whole, options)


def _annotated(motion: Motion, item: SourceItem, options: ReadOptions) -> Motion:
    check_unit(motion.skeleton, motion.joint_positions[:1], options.unit_metres, item.path)
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


# Rules of framerates


def read_rules(path: Path) -> tuple[FramerateRule, ...]:
    """The rules of a TOML file in its order; raises `UsageError` that names the file, the rule and the fault."""
    try:
        text = read_at_most(path, LONGEST_TOML).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    return parse_rules(text, str(path))


@cache
def shipped_rules() -> tuple[FramerateRule, ...]:
    """The corrections that motionkit ships, each with its source."""
    text = resources.files(__package__).joinpath("framerate_rules.toml").read_text(encoding="utf-8")
    return parse_rules(text, "shipped")


def parse_rules(text: str, name: str) -> tuple[FramerateRule, ...]:
    """The rules in TOML text; `name` is for messages. Raises `UsageError`."""
    try:
        content = parse_toml(text)
    except ValueError as error:
        raise UsageError(f"{name} is no TOML file ({error}): expected tables [[rule]], see docs/formats.md") from None
    tables = content.get("rule")
    if set(content) != {"rule"} or not isinstance(tables, list):
        raise UsageError(f"{name}: expected tables [[rule]] with files, fps and, if you like, stated, reason, source")
    return tuple(_rule(table, name, number) for number, table in enumerate(tables, start=1))


def _rule(table: Any, name: str, number: int) -> FramerateRule:
    where = f"{name}, rule {number}"
    if not isinstance(table, dict) or not {"files", "fps"} <= set(table) <= RULE_KEYS:
        raise UsageError(f"{where}: has {shown(table)}; expected files and fps, and any of stated, reason, source")
    globs = [table["files"]] if isinstance(table["files"], str) else table["files"]
    are_globs = isinstance(globs, list) and all(isinstance(each, str) and each.strip("./") for each in globs)
    if not globs or not are_globs:
        raise UsageError(f"{where}: files must be a glob in quotes, or a list of them, not {shown(globs)}")
    for key in ("reason", "source"):
        if not isinstance(table.get(key, ""), str):
            raise UsageError(f"{where}: {key} must be text in quotes, not {shown(table[key])}")
    rates: dict[str, Fraction] = {}
    for key in ("fps", "stated") if "stated" in table else ("fps",):
        value = table[key]
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise UsageError(f"{where}: {key} must be a framerate such as 120 or '30000/1001', not {shown(value)}")
        try:
            rates[key] = parse_fps(value)
        except ValueError as error:
            raise UsageError(f"{where}: {key}: {error}") from None
    short = f"{Path(name).name}, rule {number}"
    return FramerateRule(tuple(globs), rates["fps"], rates.get("stated"), table.get("source", ""), short)


def matching_rules(path: Path, root: Path, rules: tuple[FramerateRule, ...]) -> tuple[FramerateRule, ...]:
    """The rules whose globs match a file's path, relative to the parent folder of its source."""
    place = PurePosixPath(root.name, path.relative_to(root).as_posix())
    return tuple(rule for rule in rules if any(map(place.match, rule.files)))


def _corrected(item: SourceItem, options: ReadOptions, read: Reader) -> Motion:
    # The whole file, its framerate corrected by a rule unless the user has given one.
    if options.fps is not None:
        return read(item, options)
    rules = matching_rules(item.path, item.root, (*options.fps_rules, *shipped_rules()))
    try:
        motion = read(item, options)
    except FormatError as problem:
        rule = next((rule for rule in rules if rule.stated is None), None)
        if rule is None or problem.reason not in NO_FRAMERATE:
            raise
        return read(item, replace(options, fps=rule.fps)).logged(f"framerate by rule ({rule.where})")
    rule = next((rule for rule in rules if rule.stated in (None, motion.fps)), None)
    if rule is None or rule.fps == motion.fps:
        return motion
    by = f"({rule.where}{f', {rule.source}' if rule.source else ''})"
    line = f"framerate set to {rule.fps} by rule {by}; the file says {motion.fps}"
    return replace(motion, timegrid=replace(motion.timegrid, fps=rule.fps)).logged(line)
