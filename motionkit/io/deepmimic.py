"""DeepMimic's motions: JSON with one list of numbers per frame, for the humanoid of 15 joints.

A frame is its duration in seconds, the root's position in metres, and rotations: quaternions (w, x, y, z) of the root
and the spherical joints, one angle about z in radians for a revolute joint. Sources:
https://github.com/xbpeng/DeepMimic, README.md ("Mocap Data"), data/characters/humanoid3d.txt (the skeleton) and
DeepMimicCore/anim/KinTree.cpp (the axis of revolute joints).
"""

import re
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.files import parse_json
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import Feet, Skeleton
from motionkit.core.timegrid import SNAP_TOLERANCE, parse_fps
from motionkit.io import npy, source_file
from motionkit.io.body_frame import in_metres
from motionkit.io.registry import FileHead, ReadOptions

FRAMES_KEY = b'"Frames"'
ROTATION_SIZES = {"spherical": 4, "revolute": 1, "fixed": 0}
FIRST_ROTATION = 4
# In the published clips quaternions differ from unit norm by up to 0.42 (kick; most by less than 0.01), and DeepMimic
# normalises them; so does this reader, and logs it. Norms outside these limits are refused.
MAX_LENGTH_ERROR, LOGGED_LENGTH_ERROR = 0.5, 0.01
NAME = re.compile(r"(?:sie_)?humanoid3d_(?P<action>[a-z]\w*?)_?\d*", re.IGNORECASE)


def accepts(head: FileHead) -> bool:
    """Whether a text file is a JSON object with "Frames" near its beginning."""
    return head.content.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{") and FRAMES_KEY in head.content


def read_deepmimic(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one file: positions in metres, y up, true local rotations, at the framerate that the durations state.

    The last frame's duration is ignored (mostly 0). Durations that differ by more than 0.1 % are refused (`frame-time`)
    unless `options.fps` replaces them: a Motion has one framerate, and nothing is resampled.
    The action is taken from names such as `humanoid3d_zombie_walk`. Raises `FormatError`.
    """
    data = source_file.read_bytes(path)
    skeleton, rotation_sizes = humanoid3d()
    table = _table(data, rotation_sizes, path)
    fps, stated, operations = _framerate(table[:-1, 0], options.fps, path)
    rotations, normalised = _rotations(table, skeleton, rotation_sizes, path)
    operations += normalised
    root = table[:, 1:FIRST_ROTATION].astype(np.float32)
    named = NAME.fullmatch(path.stem)
    motion = source_file.motion_of(
        path, data, "deepmimic", skeleton, fps, operations, rotations=rotations, root=root, stated_fps=stated
    )
    motion = replace(motion, action=named["action"].lower() if named else "")
    return in_metres(motion, options.unit_metres)


@cache
def humanoid3d() -> tuple[Skeleton, tuple[int, ...]]:
    """The humanoid of core/skeletons/deepmimic_humanoid3d.toml, and its joints' rotation values per frame."""
    joints = source_file.shipped("core/skeletons/deepmimic_humanoid3d.toml")["joints"]
    names = tuple(joint["name"] for joint in joints)
    right = [joint for joint, name in enumerate(names) if name.startswith("right_")]
    ankles = {side: names.index(f"{side}_ankle") for side in ("left", "right")}
    skeleton = Skeleton(
        name="deepmimic-humanoid3d",
        joint_names=names,
        parents=tuple(names.index(joint["parent"]) if "parent" in joint else -1 for joint in joints),
        offsets=np.array([joint["offset"] for joint in joints], np.float32),
        left_right_pairs=tuple((names.index(names[joint].replace("right_", "left_")), joint) for joint in right),
        feet=Feet(ankles["left"], ankles["left"], ankles["right"], ankles["right"]),
        end_sites=tuple((index, tuple(joint["tip"])) for index, joint in enumerate(joints) if "tip" in joint),
    )
    return skeleton, tuple(ROTATION_SIZES[joint["rotation"]] for joint in joints)


def _table(data: bytes, rotation_sizes: tuple[int, ...], path: Path) -> Float64[np.ndarray, "frames numbers"]:
    try:
        frames = parse_json(source_file.decode(data, path))["Frames"]
        if not isinstance(frames, list):
            raise ValueError("Frames is no list")
    except (ValueError, TypeError, KeyError) as error:
        message = f"no JSON object with a list Frames ({type(error).__name__}: {error})"
        raise FormatError(message, path=path, reason="not-what-it-says") from None
    size = FIRST_ROTATION + sum(rotation_sizes)
    for number, frame in enumerate(frames):
        is_numbers = isinstance(frame, list) and all(type(value) in (int, float) for value in frame)
        if not is_numbers or len(frame) != size:
            message = f"expected the {size} numbers of DeepMimic's humanoid: duration, root position, 13 rotations"
            raise FormatError(message, path=path, reason="channel-count", frame=number)
    table = np.array(frames, np.float64)
    npy.checked_numbers(table, path)
    return table


def _framerate(
    durations: Float64[np.ndarray, "intervals"], given: Fraction | None, path: Path
) -> tuple[Fraction, str, list[str]]:
    """The framerate in use, what the durations state, and the log's lines."""
    values, counts = np.unique(np.round(durations, 7), return_counts=True)
    order = np.argsort(-counts, kind="stable")
    stated = ", ".join(f"{counts[i]} × {values[i]:g} s" for i in order[:3]) + (" …" if len(values) > 3 else "")

    def stated_fps() -> Fraction:
        if not len(values):
            raise FormatError("a single frame states no framerate; give --fps", path=path, reason="no-framerate")
        usual = float(np.median(durations))
        others = np.flatnonzero(np.abs(durations - usual) > SNAP_TOLERANCE * abs(usual))
        if others.size:
            message = f"lasts {durations[others[0]]:g} s, others {usual:g} s (in all {stated}); --fps sets one for all"
            raise FormatError(message, path=path, reason="frame-time", frame=int(others[0]))
        try:
            return parse_fps(float(1.0 / usual) if usual else float("inf"))
        except ValueError as error:
            message = f"frames last {usual:g} s ({error}); correct it, or give --fps"
            raise FormatError(message, path=path, reason="frame-time") from None

    fps, log = source_file.fps_in_use(given, stated_fps, words=stated)
    return fps, stated, log


def _rotations(
    table: Float64[np.ndarray, "frames numbers"], skeleton: Skeleton, rotation_sizes: tuple[int, ...], path: Path
) -> tuple[Float32[np.ndarray, "frames joints 4"], list[str]]:
    rotations = np.zeros((len(table), skeleton.num_joints, 4), np.float32)
    rotations[..., 0] = 1.0
    column, worst = FIRST_ROTATION, 0.0
    for joint, size in enumerate(rotation_sizes):
        values = table[:, column : column + size]
        column += size
        if size == 1:
            rotations[:, joint, 0], rotations[:, joint, 3] = np.cos(values[:, 0] / 2), np.sin(values[:, 0] / 2)
        elif size == 4:
            lengths = np.linalg.norm(values, axis=-1)
            error = np.abs(lengths - 1.0)
            frame = int(np.argmax(error))
            if error[frame] > MAX_LENGTH_ERROR:
                name = skeleton.joint_names[joint]
                message = f"the rotation of {name} is no unit quaternion (its length is {lengths[frame]:.4g})"
                raise FormatError(message, path=path, reason="range", frame=frame)
            worst = max(worst, float(error[frame]))
            rotations[:, joint] = values / lengths[:, None]
    log = f"quaternions normalised; they were off unit length by up to {worst:.3f}"
    return rotations, [log] if worst > LOGGED_LENGTH_ERROR else []
