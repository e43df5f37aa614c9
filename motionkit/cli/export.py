"""`motionkit export`: a store's motions as files again."""

from pathlib import Path
from typing import Annotated

import typer

from motionkit.console import print_json, progress, stdout
from motionkit.errors import UsageError
from motionkit.settings import default_path
from motionkit.timegrid import parse_fps


def export(
    out: Annotated[Path, typer.Argument(help="New or empty folder.", show_default=False)],
    format: Annotated[str, typer.Option(help="bvh, or joints-npy (22 joints).")] = "bvh",
    store: Annotated[Path | None, typer.Option(help="Store to export from.", show_default="./store")] = None,
    where: Annotated[
        str | None, typer.Option(help="SQL condition over the table of sequences: \"split = 'test'\".")
    ] = None,
    fps: Annotated[str | None, typer.Option(help="Resample to this framerate; native by default.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Write a store's motions as files, with motions.csv for captions, splits and exact framerates.

    The folder can be ingested again.
    """
    from motionkit.store import Store
    from motionkit.store.export import EXPORTS, motions_of

    if format not in EXPORTS:
        raise UsageError(f"unknown format {format!r}, expected one of {', '.join(EXPORTS)}")
    try:
        rate = None if fps is None else parse_fps(fps)
    except ValueError as error:
        raise UsageError(f"--fps {fps}: {error}") from None
    opened = Store.open(store or default_path("store"))
    chosen = len(opened.select(where))
    if not chosen:
        raise UsageError(f"no sequence of {opened.path} satisfies {where!r}" if where else f"{opened.path} is empty")
    with progress() as display:
        task = display.add_task("export", total=chosen, note="")
        motions = motions_of(opened, where, rate)
        num_files = sum(1 for _ in display.track(EXPORTS[format](motions, out), task_id=task))
    if as_json:
        print_json({"folder": str(out), "format": format, "files": num_files})
    else:
        stdout.print(f"wrote {num_files:,} files and motions.csv to {out}", markup=False)
