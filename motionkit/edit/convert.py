"""Converting a motion: another format, framerate or rig (docs/howto/convert.md)."""

from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.core.timegrid import Framerate, parse_fps
from motionkit.edit.motions import EditedMotion, LoadedMotion, load_motion, write_as_loaded
from motionkit.fields.resample import resample
from motionkit.io.body_frame import GIVEN_AXES, log_lines, turned
from motionkit.io.bvh import KnownFrames
from motionkit.io.character import Character, read_character
from motionkit.io.files import read_options
from motionkit.io.registry import ReadOptions, writer_of


def convert(
    motion: Motion | str | Path,
    *,
    fps: Framerate | None = None,
    rig: str | Path | None = None,
    up: str | None = None,
) -> Motion:
    """A motion at another framerate, on another rig; `save` writes it in the format of a file's suffix.

    - `motion`: a motion, or a file
    - `fps`: the new framerate; below its own it is filtered, above it interpolated (`motionkit.resample`)
    - `rig`: a character's .bvh or .glb, onto whose bones the motion is retargeted
    - `up`: the axis "x", "y" or "z" that points up in the file, or in the motion's own positions; the result is y up

    Raises `MotionkitError` for frames that hold nan or are uneven in time, and for a motion that cannot be mapped to
    the rig, `UsageError` for an invalid request.

    >>> mk.convert("walk.bvh", fps=30).save("walk.npz")
    >>> mk.read("walk.npz").num_frames
    120
    """
    if isinstance(motion, Motion):
        if up is not None and up not in GIVEN_AXES:
            raise UsageError(f"up is {up!r}, expected the axis x, y or z that points up")
        motion = turned(motion, up or "y")
        for line in log_lines(up or "y"):
            motion = motion.logged(line)
        loaded = LoadedMotion.of(motion)
    else:
        loaded = load_motion(motion, read_options(up=up))
    character = None if rig is None else read_character(Path(rig), ReadOptions())
    return converted_motion(loaded, None if fps is None else parse_fps(fps), character).motion


def converted_motion(loaded: LoadedMotion, fps: Fraction | None, character: Character | None) -> EditedMotion:
    """The motion at a framerate, on a character's rig; None keeps its own. Raises `MotionkitError`.

    A BVH file that stays one keeps its hierarchy and channels; a motion on a rig is written into a file like the
    character's own.
    """
    loaded.check_complete()
    motion = loaded.motion if fps is None else resample(loaded.motion, fps)
    kept = np.arange(motion.num_frames if motion is loaded.motion else 0)
    known = KnownFrames(np.arange(len(loaded.seconds)), loaded.seconds, kept, kept)
    write = partial(write_as_loaded, loaded, motion, known)
    if character is not None:
        motion = character.perform(motion)
        write = partial(_write_on_rig, character, motion)
    details = {
        "fps": str(loaded.motion.fps),
        "converted_fps": str(motion.fps),
        "num_frames": loaded.motion.num_frames,
        "num_converted_frames": motion.num_frames,
        "num_joints": motion.skeleton.num_joints,
    }
    return EditedMotion(motion, write, details)


def _write_on_rig(character: Character, motion: Motion, path: Path) -> None:
    suffix = path.suffix.lower()
    write = character.write if suffix == character.suffix else writer_of(suffix)
    write(motion, path)
