"""`motionkit info`: a summary of a store or a file, a store's quality, a draft of a map for a file's rig."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from motionkit.cli import console
from motionkit.core.errors import UsageError, counted, lasting
from motionkit.core.files import default_path, is_store

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
    up: console.Up = None,
    init: Annotated[
        Path | None, typer.Option(metavar="RIG.TOML", help="Draft a map of FILE's rig, for --skeleton-map.")
    ] = None,
    overwrite: console.Overwrite = False,
    quality: Annotated[
        bool, typer.Option("--quality", help="Say what looks odd: flags, worst sequences, upsampled ones.")
    ] = False,
    where: Annotated[
        str | None, typer.Option(metavar="SQL", help="With --quality: only sequences for which this holds.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Show what a store holds (sources, hours, framerates, splits, captions, size on disk), or what a file is
    (framerate, frames, height, unit, up axis, skeleton).

    Example: motionkit info --quality
    """
    if path is not None and not is_store(path):
        if store is not None or quality or where:
            raise UsageError("FILE goes with --up, --init and --json alone")
        _show_file(path, up, init, as_json, overwrite=overwrite)
        return
    if init is not None or up is not None:
        raise UsageError("--init and --up are about a file: name a FILE")
    if where and not quality:
        raise UsageError("--where goes with --quality; 'motionkit query' answers anything else")
    from motionkit.store import Store
    from motionkit.store.reports import report_quality, summarise

    opened = Store.open(console.named_store(path, store) or default_path("store"))
    if quality:
        report = report_quality(opened, where)
        console.print_json(report) if as_json else _print_lines(_quality_lines(report))
    else:
        summary = summarise(opened)
        console.print_json(summary) if as_json else _print_lines(_summary_lines(summary))


def _print_lines(lines: Iterable[str]) -> None:
    for line in lines:
        console.stdout.print(line)


def _show_file(path: Path, up: str | None, init: Path | None, as_json: bool, *, overwrite: bool) -> None:
    from motionkit.core.errors import FormatError
    from motionkit.core.files import require_new, write_whole
    from motionkit.core.skeletons.mapping import draft_map
    from motionkit.io.files import read_all
    from motionkit.io.scan import NO_FRAMERATE
    from motionkit.store.reports import describe_motion

    if init is not None:
        require_new(init, overwrite=overwrite, instead="another file keeps both")
    has_framerate = True
    try:
        motion = next(read_all(path, up=up))
    except FormatError as error:
        if error.reason not in NO_FRAMERATE:
            raise
        motion, has_framerate = next(read_all(path, fps=1, up=up)), False
    described = describe_motion(motion, has_framerate=has_framerate)
    console.print_json({"file": str(path), **described}) if as_json else _print_lines(
        [str(path), *_file_lines(described)]
    )
    if init is not None:
        write_whole(init, draft_map(motion.skeleton, init.stem))
        console.stderr.print(f"{init}: complete it; motionkit view {path} --skeleton-map {init} shows it")


def _file_lines(described: dict[str, Any]) -> Iterator[str]:
    is_other = described["stated_fps"] not in ("", described["fps"])
    stated = f" (the file says {described['stated_fps']})" if is_other else ""
    seconds = "" if described["duration_seconds"] is None else f", {described['duration_seconds']:.6g} s"
    maps = f"maps by {described['family']}" if described["family"] else "no mapping; provide --skeleton-map"
    rotations = "rotations" if described["has_rotations"] else "positions only"
    yield f"motion      {described['sequence_id']} ({described['format']})"
    yield f"fps         {'nothing says it: use --fps' if described['fps'] is None else described['fps']}{stated}"
    yield f"frames      {described['num_frames']:,}{seconds}"
    if described["height_metres"] is not None:
        yield f"height      {described['height_metres']:.3g} m from ankles to head"
    yield f"unit        {described['unit_metres']:g} m ({described['unit']})"
    yield f"up          {described['up']}"
    yield f"skeleton    {described['skeleton']}: {counted(described['num_joints'], 'joint')}, {rotations}, {maps}"
    if described["missing"]:
        yield f"missing     {', '.join(described['missing'])}"
    yield f"captions    {described['num_captions']:,}"
    if described["quality_flags"]:
        yield f"flags       {', '.join(described['quality_flags'])}"


def _quality_lines(report: dict[str, Any]) -> Iterator[str]:
    """Flags per source, the worst sequences of each flag, what seems upsampled."""
    chosen = f" where {report['where']}" if report["where"] else ""
    yield f"{report['store']}: {counted(report['num_sequences'], 'sequence')}{chosen}"
    for source in report["sources"]:
        yield ""
        name = source["source"] or "(unnamed)"
        yield f"source {name}: {counted(source['num_sequences'], 'sequence')}, {lasting(3600 * source['hours'])}"
        for flag, count in {"no flag": source["clean"], **source["flags"]}.items():
            yield f"  {flag:14}{count['num_sequences']:>8,}  {lasting(3600 * count['hours']):>10}"
    for worst in report["worst"]:
        yield ""
        yield f"worst {worst['flag']} ({worst['column']})"
        for each in worst["offenders"]:
            place = "" if each["seconds"] is None else f", at {each['seconds']:.3f} s (frame {each['frame']})"
            yield f"  {each['value']:10.4g} {worst['unit']}  {each['sequence_id']}{place}"


def _summary_lines(summary: dict[str, Any]) -> Iterator[str]:
    yield (
        f"{summary['path']}: {counted(summary['num_sequences'], 'sequence')}, {lasting(3600 * summary['hours'])}, "
        f"{counted(summary['num_frames'], 'frame')}, {counted(summary['num_skeletons'], 'skeleton')}"
    )
    for source in summary["sources"]:
        yield ""
        yield from _source_lines(source)
    yield ""
    disk, caches = summary["disk_bytes"] / MEGABYTE, summary["cache_bytes"] / MEGABYTE
    yield f"on disk {disk:,.1f} MB in {counted(summary['num_parts'], 'part')}; caches {caches:,.1f} MB"
    if summary["num_removed"]:
        yield (
            f"of it the frames of {counted(summary['num_removed'], 'removed sequence')}: 'motionkit compact --store "
            f"{summary['path']}' drops them"
        )
    yield f"fingerprint {summary['fingerprint']}"


def _source_lines(source: dict[str, Any]) -> Iterator[str]:
    captions = (
        f"{source['num_captions']:,} on {counted(source['num_captioned'], 'sequence')}"
        if source["num_captions"]
        else "none"
    )
    yield f"source      {source['source'] or '(unnamed)'}"
    size = f"{lasting(3600 * source['hours'])}, {counted(source['num_frames'], 'frame')}"
    yield f"sequences   {source['num_sequences']:,}, {size}"
    yield f"fps         {_counts(source['framerates'])}"
    yield f"durations   {_counts(source['durations'])}"
    yield f"splits      {_counts(source['splits'])}"
    yield f"captions    {captions}"
    yield f"actions     {source['num_actions']:,}"
    yield f"skeletons   {source['num_skeletons']:,} with {', '.join(source['joints'])} joints"
    yield f"formats     {_counts(source['formats'])}"
    yield f"licences    {_counts(source['licences'])}"
    if source["quality_flags"]:
        yield f"flags       {_counts(source['quality_flags'])}"


def _counts(counts: dict[str, int]) -> str:
    """`30 (7), 120 (159)`; of many only the most frequent."""
    most = sorted(counts, key=lambda name: -counts[name])[:SHOWN_COUNTS]
    shown = [f"{name or 'none'} ({counts[name]:,})" for name in counts if name in most]
    left_out = len(counts) - len(shown)
    return ", ".join(shown) + (f" and {left_out} more" if left_out else "")
