"""`motionkit info`: a summary of a store or a file, a store's quality, a file's rig."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli.console import print_json, stderr, stdout
from motionkit.cli.options import Up, named_store
from motionkit.core.errors import UsageError
from motionkit.core.files import default_path, is_store

if TYPE_CHECKING:
    from motionkit.core.motion import Motion
    from motionkit.store.reports import (
        MotionSummary,
        Offender,
        QualityReport,
        RigTree,
        SourceQuality,
        SourceSummary,
        StoreSummary,
    )

SHOWN_UPSAMPLED = 20


def quality_lines(report: "QualityReport") -> Iterator[str]:
    """The lines of a report: flags per source, the worst sequences of each flag, what seems upsampled."""
    chosen = f" where {report.where}" if report.where else ""
    yield f"{report.store}: {report.num_sequences:,} sequences{chosen}"
    for source in report.sources:
        yield ""
        yield from _source_lines(source)
    for worst in report.worst:
        yield ""
        yield f"worst {worst.flag} ({worst.column})"
        for offender in worst.offenders:
            yield f"  {_figure(offender.value)} {worst.unit}  {offender.sequence_id}{_place(offender)}"
    if report.upsampled:
        yield ""
        yield "upsampled: captured at a lower framerate than stated"
        for take in report.upsampled[:SHOWN_UPSAMPLED]:
            stated = f" (stated as {take.stated_fps})" if take.stated_fps else ""
            yield f"  {take.fps:g}{stated} → {take.effective_fps:g} fps  {take.sequence_id}"
        if len(report.upsampled) > SHOWN_UPSAMPLED:
            yield f"  and {len(report.upsampled) - SHOWN_UPSAMPLED:,} more: --json, or motionkit query"


def _source_lines(source: "SourceQuality") -> Iterator[str]:
    yield f"source {source.source or '(unnamed)'}: {source.num_sequences:,} sequences, {source.hours:.2f} h"
    yield f"  {'no flag':14}{source.clean.num_sequences:>8,}  {source.clean.hours:8.2f} h"
    for flag, count in source.flags.items():
        yield f"  {flag:14}{count.num_sequences:>8,}  {count.hours:8.2f} h"


def _figure(value: float) -> str:
    return f"{value:10.0f}" if value == int(value) else f"{value:10.4g}"


def _place(offender: "Offender") -> str:
    return "" if offender.seconds is None else f", at {offender.seconds:.3f} s (frame {offender.frame})"


MEGABYTE = 1e6
SHOWN_COUNTS = 8


def info(
    path: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE|STORE", help="A motion's file, or a store; of a folder the first motion.", show_default=False
        ),
    ] = None,
    store: Annotated[Path | None, typer.Option(help="Store to describe.", show_default="./store")] = None,
    up: Up = None,
    skeleton: Annotated[
        bool, typer.Option("--skeleton", help="Show FILE's rig, and which joints reach the 22.")
    ] = False,
    init: Annotated[
        Path | None, typer.Option(metavar="RIG.TOML", help="Draft a map of FILE's rig, for --skeleton-map.")
    ] = None,
    quality: Annotated[
        bool, typer.Option("--quality", help="Say what looks odd: flags, worst sequences, upsampled ones.")
    ] = False,
    where: Annotated[
        str | None, typer.Option(metavar="SQL", help="With --quality: only sequences for which this holds.")
    ] = None,
    html: Annotated[Path | None, typer.Option(metavar="FILE", help="Write it as a page to this file instead.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Show what a store holds (sources, hours, framerates, splits, captions, size on disk), or what a file is
    (framerate, frames, height, unit, up axis, skeleton).

    Example: motionkit info --html corpus.html
    """
    if path is not None and not is_store(path):
        if store is not None or quality or where or html is not None:
            raise UsageError("FILE goes with --up, --skeleton, --init and --json alone")
        _show_file(path, "" if up is None else up.value, skeleton, init, as_json)
        return
    if init is not None or up is not None or skeleton:
        raise UsageError("--init, --skeleton and --up are about a file: name a FILE")
    store = named_store(path, store)
    from motionkit.store import Store
    from motionkit.store.reports import report_quality, summarise

    if where and not quality:
        raise UsageError("--where goes with --quality; 'motionkit query' answers anything else")
    if html is not None and (quality or as_json):
        raise UsageError("--html writes the whole card: leave out --quality and --json")
    opened = Store.open(store or default_path("store"))
    if quality:
        _print_quality(report_quality(opened, where), as_json)
        return
    _show_store(summarise(opened), html, as_json)


def _show_store(summary: "StoreSummary", html: Path | None, as_json: bool) -> None:
    if html is not None:
        from motionkit.core.files import write_whole
        from motionkit.viz.corpus_card import corpus_card

        write_whole(html, corpus_card(summary, whole_page=True))
        stdout.print(str(html))
    elif as_json:
        print_json({**asdict(summary), "raw_bytes": summary.raw_bytes})
    else:
        _print_summary(summary)


def _show_file(path: Path, up: str, skeleton: bool, init: Path | None, as_json: bool) -> None:
    from motionkit.core.files import write_whole
    from motionkit.core.skeletons.mapping import draft_map
    from motionkit.store.reports import rig_of, summarise_motion

    motion, has_framerate = _first_motion(path, up)
    text = None
    if init is not None:
        if init.exists():
            raise UsageError(f"{init} exists: name another file, or delete it")
        text = draft_map(motion.skeleton, init.stem)
    found, rig = summarise_motion(motion, has_framerate=has_framerate), rig_of(motion.skeleton)
    if as_json:
        print_json({"file": str(path), **asdict(found), **asdict(rig)})
    else:
        stdout.print(str(path))
        for name, value in _file_lines(found, rig):
            stdout.print(f"{name:12}{value}")
        if skeleton:
            _print_rig(rig)
    if text is not None and init is not None:
        write_whole(init, text)
        stderr.print(f"{init}: complete it; motionkit view {path} --skeleton-map {init} shows it")


def _first_motion(path: Path, up: str) -> "tuple[Motion, bool]":
    """The first motion of a file or folder, and whether something says its framerate."""
    from motionkit.core.errors import FormatError
    from motionkit.io.files import read_all
    from motionkit.io.reading import NO_FRAMERATE

    try:
        return next(read_all(path, up=up or None)), True
    except FormatError as error:
        if error.reason not in NO_FRAMERATE:
            raise
        return next(read_all(path, fps=1, up=up or None)), False


def _file_lines(found: "MotionSummary", rig: "RigTree") -> list[tuple[str, str]]:
    stated = f" (the file says {found.stated_fps})" if found.stated_fps else ""
    seconds = "" if found.duration_seconds is None else f", {found.duration_seconds:.6g} s"
    height = "unknown" if found.height_metres is None else f"{found.height_metres:.3g} m from ankles to head"
    maps = f"maps by {rig.family}" if rig.family else "no mapping; provide --skeleton-map"
    rotations = "rotations" if found.has_rotations else "positions only"
    lines = [
        ("motion", f"{found.sequence_id} ({found.format})"),
        ("fps", "nothing says it: use --fps" if found.fps is None else f"{found.fps}{stated}"),
        ("frames", f"{found.num_frames:,}{seconds}"),
        ("height", height),
        ("unit", f"{found.unit_metres:g} m ({found.unit})"),
        ("up", found.up),
        ("skeleton", f"{found.skeleton}: {found.num_joints} joints, {rotations}, {maps}"),
        ("captions", f"{found.num_captions:,}"),
    ]
    return [*lines, ("flags", ", ".join(found.quality_flags))] if found.quality_flags else lines


def _print_rig(rig: "RigTree") -> None:
    for joint in rig.joints:
        x, y, z = joint.offset
        name = f"{'  ' * joint.depth}{joint.name}"
        stdout.print(f"{name:32} {x:7.3f} {y:7.3f} {z:7.3f}  {', '.join(joint.taken_for)}".rstrip())
    if rig.missing:
        stdout.print(f"missing: {', '.join(rig.missing)}")


def _print_quality(report: "QualityReport", as_json: bool) -> None:
    if as_json:
        print_json(asdict(report))
        return
    for line in quality_lines(report):
        stdout.print(line)


def _print_summary(summary: "StoreSummary") -> None:
    stdout.print(
        f"{summary.path}: {summary.num_sequences:,} sequences, {summary.hours:.2f} h, {summary.num_frames:,} frames, "
        f"{summary.num_skeletons:,} skeletons",
    )
    for source in summary.sources:
        stdout.print()
        for name, text in _lines(source):
            stdout.print(f"{name:12}{text}")
    stdout.print()
    ratio = summary.disk_bytes / summary.raw_bytes if summary.raw_bytes else 0.0
    stdout.print(
        f"on disk {summary.disk_bytes / MEGABYTE:,.1f} MB in {summary.num_parts:,} parts, {ratio:.3f} of raw float32 "
        f"({summary.raw_bytes / MEGABYTE:,.1f} MB); caches {summary.cache_bytes / MEGABYTE:,.1f} MB"
    )
    for name, column in summary.columns.items():
        if column.raw_bytes:
            stdout.print(
                f"  {name} {column.disk_bytes / MEGABYTE:,.1f} MB, {column.disk_bytes / column.raw_bytes:.3f} of raw"
            )
    if summary.num_removed:
        stdout.print(
            f"of it the frames of {summary.num_removed:,} removed sequences: 'motionkit compact --store "
            f"{summary.path}' drops them",
        )
    stdout.print(f"fingerprint {summary.fingerprint}")


def _lines(source: "SourceSummary") -> list[tuple[str, str]]:
    captions = f"{source.num_captions:,} on {source.num_captioned:,} sequences" if source.num_captions else "none"
    lines = [
        ("source", source.source or "(unnamed)"),
        ("sequences", f"{source.num_sequences:,}, {source.hours:.2f} h, {source.num_frames:,} frames"),
        ("fps", _counts(source.framerates)),
        ("durations", _counts(source.durations)),
        ("splits", _counts(source.splits)),
        ("captions", captions),
        ("actions", f"{source.num_actions:,}"),
        ("skeletons", f"{source.num_skeletons:,} with {', '.join(source.joints)} joints"),
        ("formats", _counts(source.formats)),
        ("licences", _counts(source.licences)),
    ]
    return [*lines, ("flags", _counts(source.quality_flags))] if source.quality_flags else lines


def _counts(counts: dict[str, int]) -> str:
    """`30 (7), 120 (159)`; of many only the most frequent."""
    most = sorted(counts, key=lambda name: -counts[name])[:SHOWN_COUNTS]
    shown = [f"{name or 'none'} ({counts[name]:,})" for name in counts if name in most]
    left_out = len(counts) - len(shown)
    return ", ".join(shown) + (f" and {left_out} more" if left_out else "")
