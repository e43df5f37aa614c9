"""All formats, motionkit's own and those of the entry point group `motionkit.io`: recognising files, writing."""

from collections.abc import Callable, Mapping
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from motionkit.core.errors import UsageError
from motionkit.core.files import whole_file
from motionkit.core.motion import Motion
from motionkit.io import (
    amass,
    asfamc,
    c3d,
    deepmimic,
    gltf,
    humanact12,
    humanml3d,
    joints_csv,
    joints_npy,
    kimodo,
    npz,
    parquet,
    pose_vectors,
    robot_csv,
    smpl,
    trc,
    uestc,
)
from motionkit.io.bvh import lafan1, style100
from motionkit.io.bvh import writing as bvh
from motionkit.io.format import FileHead, Format

GROUP = "motionkit.io"

# The first that accepts a file reads it.
_BUILT_IN = (
    *(
        lafan1.FORMAT,
        style100.FORMAT,
        bvh.FORMAT,
        asfamc.FORMAT,
        c3d.FORMAT,
        trc.FORMAT,
        deepmimic.FORMAT,
        uestc.FORMAT,
    ),
    *(kimodo.FORMAT, smpl.FORMAT, smpl.MOTION_X_FORMAT),
    *(amass.FORMAT, humanml3d.FORMAT, humanml3d.KIT_FORMAT, humanact12.FORMAT, joints_npy.FORMAT, npz.FORMAT),
    *(pose_vectors.FORMAT, pose_vectors.INTERHUMAN_FORMAT, pose_vectors.MOTIONSTREAMER_FORMAT),
    *(joints_csv.FORMAT, robot_csv.FORMAT, gltf.FORMAT, parquet.FORMAT),
)


@cache
def readers() -> Mapping[str, Format]:
    """The formats with a reader, by name, in the order in which they are tried: installed ones first."""
    return {each.name: each for each in _all() if each.read is not None}


@cache
def _by_suffix(name: str) -> Mapping[str, tuple[Format, ...]]:
    # The formats that read files, or only the one of this name, in order.
    found: dict[str, tuple[Format, ...]] = {}
    for each in readers().values():
        for suffix in each.suffixes if name in ("auto", each.name) else ():
            found[suffix] = (*found.get(suffix, ()), each)
    return found


def recognise(head: FileHead, name: str = "auto") -> Format | None:
    """The format of a file by its suffix, then its content; None for any other file, and for formats not of `name`."""
    kinds = _by_suffix(name).get(head.path.suffix.lower(), ())
    return next((each for each in kinds if each.accepts(head)), None)


def recognise_unnamed(head: FileHead, name: str = "auto") -> Format | None:
    """The format of a file whose suffix does not say it, by its first word."""
    lines = map(bytes.strip, head.content.removeprefix(b"\xef\xbb\xbf").splitlines())
    first = next((line for line in lines if line and not line.startswith(b"#")), b"").upper()
    kinds = (each for each in readers().values() if name in ("auto", each.name) and each.begins)
    return next((each for each in kinds if first.startswith(each.begins) and each.accepts(head)), None)


@cache
def writers() -> Mapping[str, Format]:
    """The formats that write one motion per file, by name."""
    return {each.name: each for each in _all() if each.write is not None}


def writer_of(suffix: str) -> Callable[[Motion, Path], None]:
    """The function that writes a motion to a file of this suffix: of several formats, that of the suffix's name.

    Raises `UsageError` for a suffix that no format writes.
    """
    fitting = {each.name: each.write for each in writers().values() if each.suffixes[0] == suffix and each.write}
    if not fitting:
        suffixes = ", ".join(sorted({each.suffixes[0] for each in writers().values()}))
        raise UsageError(f"a motion is written as {suffixes}, by the suffix of the file's name, not as {suffix!r}")
    return fitting.get(suffix[1:]) or next(iter(fitting.values()))


def _all() -> list[Format]:
    installed = sorted(entry_points(group=GROUP), key=lambda entry: entry.name)
    return [*(entry.load() for entry in installed), *_BUILT_IN]


def write(motion: Motion, path: str | Path) -> None:
    """Write a motion to a file; the suffix selects the format.

    - `.npz`: all of the motion, lossless
    - `.bvh`: the skeleton and its rotations, in centimetres; by inverse kinematics if the motion has none
    - `.glb`: glTF, an animated skeleton with a visible body, for engines and viewers
    - `.csv`: time stamps and joint positions in metres
    - `.npy`: joint positions [T, J, 3] in metres of the 22 joints (KIT-ML's 21 if the motion has these), the
      framerate in `motions.json` beside the file

    Folders are created, an existing file is replaced, and the file is written atomically. Raises `UsageError` for any
    other suffix, `ValueError` for an `.npy` beside those of another framerate, `MotionkitError` for one of a skeleton
    that cannot be mapped to the 22 joints, and `OSError`.

    >>> motion = mk.read("walk.bvh")
    >>> mk.write(motion, "out/walk.npz")
    >>> mk.read("out/walk.npz").num_frames
    240
    """
    path = Path(path)
    write_file = writer_of(path.suffix.lower())
    with whole_file(path) as temporary:
        write_file(motion, temporary)
