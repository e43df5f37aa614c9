"""`motionkit view`: moving skeletons in a page that opens from disk."""

from dataclasses import replace
from pathlib import Path

import typer

from motionkit.cli import view_options as option
from motionkit.cli.reading import read_options
from motionkit.console import print_json, progress, stderr, stdout
from motionkit.core.progress import task
from motionkit.errors import MotionkitError, UsageError
from motionkit.settings import default_path


def view(
    clips: option.Clips = None,
    store: option.StorePath = None,
    where: option.Where = None,
    limit: option.Limit = 6,
    from_seconds: option.FromSeconds = None,
    to_seconds: option.ToSeconds = None,
    fps: option.GivenFps = None,
    unit_metres: option.UnitMetres = None,
    format: option.FormatName = "auto",
    skeleton_map: option.SkeletonMaps = None,
    out: option.OutPlace = None,
    overwrite: option.Overwrite = False,
    open_page: option.OpenPage = False,
    as_json: option.AsJson = False,
) -> None:
    """Look at motions: one page with moving skeletons, each at its native framerate, on one clock in seconds.

    The page is one file that loads nothing from elsewhere: open it in any browser, send it to anybody.
    """
    from motionkit.skeletons.families import read_skeleton_map
    from motionkit.viewing.job import Stretch, page_path, read_takes, write_view
    from motionkit.viewing.sources import find_sources, stored_where

    stretch = Stretch(from_seconds, to_seconds)
    options = replace(
        read_options(format, fps, unit_metres), skeleton_maps=tuple(map(read_skeleton_map, skeleton_map or ()))
    )
    place = store or default_path("store")
    stored = [] if where is None else stored_where(place, where)
    if where is not None and not stored:
        raise UsageError(f"no sequence of {place} satisfies {where!r}")
    if not clips and not stored:
        raise UsageError(
            "name motions to look at: files, folders, ids of a store, or --where for some of its sequences"
        )
    named, problems = find_sources(clips or (), options, place)
    sources = [*named, *stored]
    if len(sources) > limit:
        stderr.print(f"motionkit: the first {limit} of {len(sources):,} motions are shown: --limit shows more")
        sources = sources[:limit]
    failures = [(str(problem.path), str(problem)) for problem in problems]
    path = page_path(out, sources) if sources else Path()
    if sources and path.exists() and not overwrite:
        raise MotionkitError(f"{path} exists: --overwrite replaces it, --out writes elsewhere")
    with progress() as show, task(show, "read", len(sources)) as work:
        takes, failed = read_takes(sources, stretch, work.advance)
    failures += failed
    for name, message in failures:
        stderr.print(f"motionkit: {message if name in message else f'{name}: {message}'}", markup=False)
    viewed = write_view(path, takes, stretch) if takes else None
    if as_json:
        plain = {"page": None, "bytes": 0, "motions": []} if viewed is None else viewed.plain()
        print_json({**plain, "failed": [{"clip": name, "message": message} for name, message in failures]})
    elif viewed is not None:
        stdout.print(str(viewed.path), markup=False)
    if viewed is not None and open_page:
        _open(viewed.path)
    if failures:
        raise typer.Exit(1)


def _open(path: Path) -> None:
    import webbrowser

    if not webbrowser.open(path.absolute().as_uri()):
        stderr.print(f"motionkit: no browser found here: open {path} in one", markup=False)
