"""`motionkit samples`: inspect a folder of samples before building a table from it."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.cli.console import AsJson, Overwrite, Up, parse_rate, print_json, progress, stderr, stdout
from motionkit.core.errors import UsageError, counted
from motionkit.core.files import require_new, write_whole

if TYPE_CHECKING:
    from eval.sample_folder import SampleFolder


def samples(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder, or file, of another system's motions.")],
    init: Annotated[bool, typer.Option("--init", help="Write DIR/samples.toml first, to be completed.")] = False,
    overwrite: Overwrite = False,
    fps: Annotated[str | None, typer.Option(metavar="FPS", help="Framerate, where the files do not say it.")] = None,
    up: Up = None,
    as_json: AsJson = False,
) -> None:
    """Say what a folder of samples holds: motions, framerates, captions, prompts, bodies, and what is wrong.

    Example: motionkit samples takes
    """
    from eval.sample_folder import SampleFolderError, SampleOptions, read_sample_folder

    if init:
        _write_manifest(folder, {"fps": fps, "up": up}, overwrite)
    with progress() as show:
        read = read_sample_folder(folder.name, folder, SampleOptions(parse_rate(fps), up or ""), show)
    summary = _summary(read)
    if as_json:
        print_json(summary)
    for name, text in () if as_json else _lines(summary):
        stdout.print(f"{name:12}{text}")
    if read.left_out:
        raise SampleFolderError(f"left out of every table: {counted(len(read.left_out), 'motion')} of {str(folder)!r}")


def _write_manifest(folder: Path, stated: Mapping[str, str | None], overwrite: bool) -> None:
    """Write a new `samples.toml`: a template of explained comments, in which some keys are stated."""
    from eval.sample_folder.reading import MANIFEST

    path, text = folder / MANIFEST, (resources.files("eval.sample_folder") / MANIFEST).read_text(encoding="utf-8")
    if not folder.is_dir():
        raise UsageError(f"--init writes {MANIFEST} into a folder, and {str(folder)!r} is none")
    require_new(path, overwrite=overwrite, instead="it is read without --init")
    for key, value in stated.items():
        if value is not None:
            text = re.sub(rf"(?m)^# {key} = .*?(?=  #)", f'{key} = "{value}"', text)
    write_whole(path, text)
    stderr.print(f"written: {path}")


def _summary(folder: "SampleFolder") -> dict[str, Any]:
    """Counts and sizes of the motions that were read (`frames`: minimum, median, maximum), and problems of others."""
    import numpy as np

    from eval.sample_folder.reading import some_poses
    from motionkit.io.body_frame import bone_lengths

    lengths, poses = folder.sequences.num_frames, some_poses(list(folder.sequences))
    actions = Counter(filter(None, folder.actions))
    return {
        "name": folder.name,
        "num_motions": len(folder.sequences),
        "duration_seconds": folder.duration_seconds,
        "frames": [int(lengths.min()), int(np.median(lengths)), int(lengths.max())],
        "framerates": {str(fps): count for fps, count in sorted(Counter(folder.fps).items())},
        "num_captioned": sum(map(bool, folder.captions)),
        "num_different_captions": len(set(filter(None, folder.captions))),
        "num_with_action": actions.total(),
        "actions": dict(actions.most_common()),
        "prompt_sizes": dict(sorted(Counter(Counter(folder.groups).values()).items())),
        "body_metres": float(np.median(bone_lengths(poses).sum(axis=-1))),
        "remarks": folder.remarks,
        "left_out": [str(problem) for problem in folder.left_out],
    }


def _lines(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The summary as lines: a label, and the text."""

    def share(count: int, num_different: int) -> str:
        return f"{count:,}, {num_different:,} different" if count else "none"

    low, middle, high = summary["frames"]
    minutes = f"{summary['duration_seconds'] / 60:.1f} min"
    yield "motions", f"{summary['num_motions']:,}, {minutes}, {low} to {counted(high, 'frame')} (median {middle})"
    yield "framerate", ", ".join(f"{fps} fps ({count:,})" for fps, count in summary["framerates"].items())
    yield "captions", share(summary["num_captioned"], summary["num_different_captions"])
    yield "actions", share(summary["num_with_action"], len(summary["actions"]))
    sizes = sorted(summary["prompt_sizes"].items(), key=lambda entry: -entry[1])[:4]
    yield "prompts", ", ".join(f"{count:,} with {size:,} motion{'s'[: size > 1]} each" for size, count in sizes)
    yield "bodies", f"{summary['body_metres']:.2f} m from ankle to head"
    yield from (("note", remark) for remark in summary["remarks"])
    yield from (("left out", problem) for problem in summary["left_out"])
