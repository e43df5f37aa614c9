"""`motionkit info`: a summary of a store or a file, a store's quality, a file's rig."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.cli.console import print_json, stderr, stdout
from motionkit.cli.options import Up, named_store
from motionkit.core.errors import UsageError
from motionkit.core.files import default_path, is_store

if TYPE_CHECKING:
    from motionkit.core.motion import Motion
    from motionkit.store.reports import SourceSummary, StoreSummary

SHOWN_UPSAMPLED = 20


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
        report = report_quality(opened, where)
        print_json(report) if as_json else _print_quality(report)
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
    from motionkit.store.reports import describe_motion, describe_rig

    motion, has_framerate = _first_motion(path, up)
    text = None
    if init is not None:
        if init.exists():
            raise UsageError(f"{init} exists: name another file, or delete it")
        text = draft_map(motion.skeleton, init.stem)
    found = {**describe_motion(motion, has_framerate=has_framerate), **describe_rig(motion.skeleton)}
    if as_json:
        print_json({"file": str(path), **found})
    else:
        stdout.print(str(path))
        _print_motion(found)
        if skeleton:
            _print_rig(found)
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


def _print_motion(found: dict[str, Any]) -> None:
    stated = f" (the file says {found['stated_fps']})" if found["stated_fps"] else ""
    seconds = "" if found["duration_seconds"] is None else f", {found['duration_seconds']:.6g} s"
    height = "unknown" if found["height_metres"] is None else f"{found['height_metres']:.3g} m from ankles to head"
    maps = f"maps by {found['family']}" if found["family"] else "no mapping; provide --skeleton-map"
    rotations = "rotations" if found["has_rotations"] else "positions only"
    lines = {
        "motion": f"{found['sequence_id']} ({found['format']})",
        "fps": "nothing says it: use --fps" if found["fps"] is None else f"{found['fps']}{stated}",
        "frames": f"{found['num_frames']:,}{seconds}",
        "height": height,
        "unit": f"{found['unit_metres']:g} m ({found['unit']})",
        "up": found["up"],
        "skeleton": f"{found['skeleton']}: {found['num_joints']} joints, {rotations}, {maps}",
        "captions": f"{found['num_captions']:,}",
        "flags": ", ".join(found["quality_flags"]),
    }
    for name, value in lines.items():
        if value:
            stdout.print(f"{name:12}{value}")


def _print_rig(rig: dict[str, Any]) -> None:
    for joint in rig["joints"]:
        x, y, z = joint["offset"]
        name = f"{'  ' * joint['depth']}{joint['name']}"
        stdout.print(f"{name:32} {x:7.3f} {y:7.3f} {z:7.3f}  {', '.join(joint['taken_for'])}".rstrip())
    if rig["missing"]:
        stdout.print(f"missing: {', '.join(rig['missing'])}")


def _print_quality(report: dict[str, Any]) -> None:
    """Flags per source, the worst sequences of each flag, what seems upsampled."""
    chosen = f" where {report['where']}" if report["where"] else ""
    stdout.print(f"{report['store']}: {report['num_sequences']:,} sequences{chosen}")
    for source in report["sources"]:
        name = source["source"] or "(unnamed)"
        stdout.print()
        stdout.print(f"source {name}: {source['num_sequences']:,} sequences, {source['hours']:.2f} h")
        for flag, count in {"no flag": source["clean"], **source["flags"]}.items():
            stdout.print(f"  {flag:14}{count['num_sequences']:>8,}  {count['hours']:8.2f} h")
    for worst in report["worst"]:
        stdout.print()
        stdout.print(f"worst {worst['flag']} ({worst['column']})")
        for each in worst["offenders"]:
            value = each["value"]
            figure = f"{value:10.0f}" if value == int(value) else f"{value:10.4g}"
            place = "" if each["seconds"] is None else f", at {each['seconds']:.3f} s (frame {each['frame']})"
            stdout.print(f"  {figure} {worst['unit']}  {each['sequence_id']}{place}")
    if report["upsampled"]:
        stdout.print()
        stdout.print("upsampled: captured at a lower framerate than stated")
        for each in report["upsampled"][:SHOWN_UPSAMPLED]:
            stated = f" (stated as {each['stated_fps']})" if each["stated_fps"] else ""
            stdout.print(f"  {each['fps']:g}{stated} → {each['effective_fps']:g} fps  {each['sequence_id']}")
        if len(report["upsampled"]) > SHOWN_UPSAMPLED:
            stdout.print(f"  and {len(report['upsampled']) - SHOWN_UPSAMPLED:,} more: --json, or motionkit query")


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
