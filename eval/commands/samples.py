"""`motionkit samples`: inspect a folder of samples before building a table from it."""

from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.console import Up, print_json, progress, stderr, stdout
from motionkit.core.errors import UsageError
from motionkit.core.files import write_whole
from motionkit.core.progress import task

STATISTICS_FILES = {"mean": "mean.npy", "std": "std.npy"}


def samples(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder, or file, of another system's motions.")],
    init: Annotated[
        bool, typer.Option("--init", help="Write DIR/samples.toml first, with what is given here, to be completed.")
    ] = False,
    fps: Annotated[str | None, typer.Option(metavar="FPS", help="Framerate, where the files do not say it.")] = None,
    unit_metres: Annotated[
        float | None, typer.Option("--unit-metres", metavar="M", help="With --init: metres per unit of the files.")
    ] = None,
    up: Up = None,
    statistics: Annotated[
        str | None, typer.Option(help="With --init: pose vectors are raw, or normalised (with --mean and --std).")
    ] = None,
    mean: Annotated[Path | None, typer.Option(help="With --init: mean of the vectors, .npy; copied into DIR.")] = None,
    std: Annotated[Path | None, typer.Option(help="With --init: their standard deviation; copied into DIR.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
) -> None:
    """Say what a folder of samples holds: motions, framerates, captions, prompts, bodies, and what is wrong.

    Example: motionkit samples takes
    """
    from dataclasses import asdict

    from eval.sample_folder import SampleFolderError, SampleOptions, read_sample_folder
    from eval.sample_folder.findings import lines, summarise
    from motionkit.core.timegrid import parse_fps

    try:
        framerate = None if fps is None else parse_fps(fps)
    except ValueError as error:
        raise UsageError(f"--fps {fps}: {error}") from None
    given = {
        "fps": framerate,
        "unit_metres": unit_metres,
        "up": up,
        "statistics": statistics,
        "mean": mean,
        "std": std,
    }
    stated: dict[str, object] = {key: value for key, value in given.items() if value is not None}
    if init:
        _write_manifest(folder, stated)
    elif stated.keys() - {"fps", "up"}:
        raise UsageError(f"--{sorted(stated.keys() - {'fps', 'up'})[0].replace('_', '-')} goes with --init")
    with progress() as show, task(show, "reading") as work:
        read = read_sample_folder(folder.name, folder, SampleOptions(framerate, "--fps", up or ""), work.set)
    found = summarise(read)
    if as_json:
        print_json(asdict(found))
    else:
        for name, text in lines(found):
            stdout.print(f"{name:12}{text}")
    if found.left_out:
        raise SampleFolderError(f"{len(found.left_out):,} motions of {str(folder)!r} are left out of every table")


def _write_manifest(folder: Path, stated: dict[str, object]) -> None:
    """Write a new `samples.toml`, with the statistics' files beside it."""
    from eval.sample_folder.manifest import MANIFEST, NORMALISED, RAW, manifest_text

    if not folder.is_dir():
        raise UsageError(f"--init needs a folder, and {str(folder)!r} is not one")
    path = folder / MANIFEST
    if path.exists() and path.stat().st_size:
        raise UsageError(f"{path} is there already: edit it, or remove it first")
    if stated.get("statistics") not in (None, RAW, NORMALISED):
        raise UsageError(f"--statistics {stated['statistics']}: expected {RAW} or {NORMALISED}")
    if not (stated.get("statistics") == NORMALISED) == ("mean" in stated) == ("std" in stated):
        raise UsageError("--statistics normalised needs --mean FILE and --std FILE, and they need it")
    for key, name in STATISTICS_FILES.items():
        source = stated.get(key)
        if isinstance(source, Path):
            if not source.is_file():
                raise UsageError(f"--{key} {source}: there is no such file")
            if source.resolve() != (folder / name).resolve():
                write_whole(folder / name, source.read_bytes())
            stated[key] = name
    write_whole(path, manifest_text(stated))
    stderr.print(f"written: {path}")
