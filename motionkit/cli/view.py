"""`motionkit view`: show motions as moving skeletons in a page."""

from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal

import typer

from motionkit.cli import console
from motionkit.core.errors import UsageError, counted
from motionkit.core.files import default_path, require_new
from motionkit.core.progress import task
from motionkit.viz import MOST_MOTIONS

FILMS = (".mp4", ".gif", ".png", ".rrd")


def view(
    clips: console.Clips = None,
    store: console.StorePath = None,
    where: console.Where = None,
    limit: Annotated[
        int,
        typer.Option(min=1, max=MOST_MOTIONS, help="Maximum number of motions in the page; of a store, unlike ones."),
    ] = 6,
    from_seconds: Annotated[
        float | None, typer.Option("--from", metavar="SECONDS", help="Start at this time.", show_default=False)
    ] = None,
    to_seconds: Annotated[
        float | None, typer.Option("--to", metavar="SECONDS", help="Stop before this time.", show_default=False)
    ] = None,
    fps: Annotated[
        str | None,
        typer.Option(help="Framerate of files that state none or a wrong one (.amc, .npy).", show_default=False),
    ] = None,
    unit_metres: Annotated[
        float | None,
        typer.Option(help="Length of one file unit in metres: 0.01 for centimetres.", show_default=False),
    ] = None,
    up: console.Up = None,
    film_format: Annotated[
        Literal["mp4", "gif", "png", "rrd"] | None,
        typer.Option("--format", help="A film, a strip of poses or a recording instead of a page.", show_default=False),
    ] = None,
    skeleton_map: console.SkeletonMaps = None,
    page_file: Annotated[
        Path | None,
        typer.Option(
            "--page", help="Write all sequences of a store as cards to filter, play and mark.", show_default=False
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write.", show_default="NAME.view.html here")] = None,
    speed: Annotated[
        float | None,
        typer.Option(help="Playback speed of an mp4 or a gif: 0.25 is four times slower.", show_default="1"),
    ] = None,
    overwrite: console.Overwrite = False,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    as_json: console.AsJson = False,
) -> None:
    """Show motions in one page with moving skeletons, each at its native framerate, on one clock in seconds.

    The page is one self-contained file; --format mp4, gif, png or rrd makes films, strips, Rerun's files.

    Example: motionkit view takes/walk.bvh takes/jump.bvh"""
    from motionkit.edit.motions import find_motions
    from motionkit.viz.view import PAGE_SUFFIX, Interval, page_path, read_panels, spread, write_view

    if page_file is not None:
        others: dict[str, object] = {"from": from_seconds, "to": to_seconds, "fps": fps, "up": up, "speed": speed}
        others |= {"unit-metres": unit_metres, "format": film_format, "skeleton-map": skeleton_map, "out": out}
        if ignored := [f"--{name}" for name, value in others.items() if value]:
            raise UsageError(f"--page shows a store's sequences whole and as they are: leave out {', '.join(ignored)}")
        _write_cards(page_file, clips or [], store, where, overwrite=overwrite, open_page=open_page, as_json=as_json)
        return
    interval = Interval(from_seconds, to_seconds)
    suffix = f".{film_format}" if film_format else "" if out is None else out.suffix.lower()
    film = suffix if suffix in FILMS else ""
    if film and out is not None and not out.is_dir() and out.suffix.lower() != film:
        raise UsageError(f"--out {out} is no {film[1:]} file by its name: call it {out.with_suffix(film)}")
    if speed is not None and not (film in (".mp4", ".gif") and 0 < speed < float("inf")):
        raise UsageError("--speed is a positive number and goes with --format mp4 or gif; a page has its own speed")
    options = console.read_options(console.parse_rate(fps), skeleton_map, unit_metres=unit_metres, up=up)
    if not clips and where is None:
        raise UsageError("name motions to look at: files, folders, a store, its ids, or --where")
    sources, problems = find_motions(clips or (), options, store or default_path("store"), where)
    if len(sources) > limit:
        which = "unlike ones" if sources[0].kind else "the first"
        console.stderr.print(
            f"motionkit: {limit} of {counted(len(sources), 'motion')} are shown, {which}: --limit shows more"
        )
        sources = spread(sources, limit)
    page = page_path(out, sources, film or PAGE_SUFFIX) if sources else Path()
    if sources:
        require_new(page, overwrite=overwrite, instead="--out writes elsewhere")
    with console.progress() as show, task(show, "read", len(sources)) as work:
        panels, failed = read_panels(sources, interval, work.advance)
    failures = [*((str(problem.path), str(problem)) for problem in problems), *failed]
    console.print_failures(failures)
    if panels and film:
        from motionkit.viz.film import write_film

        with console.progress() as show:
            write_film(page, panels, Fraction(speed or 1.0).limit_denominator(1000), show)
    elif panels:
        write_view(page, panels, interval)
    if as_json:
        motions = [
            {
                "name": panel.name,
                "fps": str(panel.fps),
                "first_frame": panel.first_frame,
                "num_frames": panel.num_frames,
                "start_seconds": panel.start_seconds,
                "duration_seconds": panel.duration_seconds,
                "num_joints": panel.skeleton.num_joints,
            }
            for panel in panels
        ]
        written = {"page": str(page), "bytes": page.stat().st_size} if panels else {"page": None, "bytes": 0}
        unshown = [{"clip": name, "message": message} for name, message in failures]
        console.print_json({**written, "motions": motions, "failed": unshown})
    elif panels:
        console.stdout.print(str(page))
    if panels and open_page:
        _open(page)
    if failures:
        raise typer.Exit(1)


def _write_cards(
    page: Path,
    names: list[str],
    store: Path | None,
    where: str | None,
    *,
    overwrite: bool,
    open_page: bool,
    as_json: bool,
) -> None:
    from motionkit.store import Store
    from motionkit.viz.corpus_page import write_corpus_page

    if len(names) > 1:
        raise UsageError("--page shows one store: name it alone, and choose with --where")
    path = console.named_store(Path(names[0]) if names else None, store) or default_path("store")
    opened = Store.open(path)
    indices = opened.select_some(where)
    require_new(page, overwrite=overwrite, instead="another file keeps both")
    with console.progress() as show:
        failures = write_corpus_page(page, opened, indices, show)
    console.print_failures(failures)
    num_bytes = page.stat().st_size
    if as_json:
        unshown = [{"clip": name, "message": message} for name, message in failures]
        console.print_json({"page": str(page), "bytes": num_bytes, "sequences": len(indices), "failed": unshown})
    else:
        console.stdout.print(f"{page}: {counted(len(indices) - len(failures), 'sequence')}, {num_bytes / 1e6:.1f} MB")
    if open_page:
        _open(page)
    if failures:
        raise typer.Exit(1)


def _open(page: Path) -> None:
    import webbrowser

    if not webbrowser.open(page.absolute().as_uri()):
        console.stderr.print(f"motionkit: no browser found here: open {page} in one")
