"""Joint positions in .npy files [T, J, 3], with the framerate from `motions.json`, an annotation CSV or an option.

`motions.json` beside the files has the form `{"fps": "30000/1001", "layout": "smpl22", "unit_metres": 1.0}`; without it
the layout follows from J: 22, 24 and 52 joints are SMPL's (SMPL-H's 30 hand joints are dropped), 21 are KIT's.

HumanAct12's 1,191 clips of 12 actions have this form: 24 joints, 20 fps, the action's code in the file's name
(https://github.com/EricGuo5513/action-to-motion). According to its author, the capture really ran at 15 fps (HumanML3D
issue 124; set `--fps 15`). Users report that left and right are swapped (issue 147); the files' sides are not changed.
"""

import re
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError, shown
from motionkit.core.files import parse_json, write_json
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS, Skeleton
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import parse_fps
from motionkit.io import npy, source_file
from motionkit.io.body_frame import upright
from motionkit.io.registry import FileHead, ReadOptions

MANIFEST = "motions.json"
HUMANACT12_FPS = Fraction(20)
HUMANACT12_NAME = re.compile(r"P(?P<subject>\d+)G\d+R\d+F\d+T\d+A(?P<action>\d\d)\d\d", re.IGNORECASE)
HUMANACT12_ACTIONS = (
    *("warm_up", "walk", "run", "jump", "drink", "lift_dumbbell"),
    *("sit", "eat", "turn_steering_wheel", "phone", "boxing", "throw"),
)
LAYOUT_BY_JOINTS = {21: "kit21", 22: "smpl22", 24: "smpl22", 52: "smpl22"}


@dataclass(frozen=True)
class Manifest:
    """The contents of `motions.json`, which describes the arrays beside it."""

    fps: Fraction | None = None
    layout: str = ""
    unit_metres: float = 1.0


def accepts(head: FileHead) -> bool:
    """Whether a .npy file is a sequence of joints; a broken header passes, so that reading it reports the fault."""
    shape = head.array_shape
    return shape is None or (len(shape) == 3 and shape[2] == 3)


def is_humanact12(head: FileHead) -> bool:
    """Whether a .npy file has HumanAct12's form of name and shape, or a broken header."""
    return HUMANACT12_NAME.fullmatch(head.path.stem) is not None and (head.array_shape or (0, 24, 3))[1:] == (24, 3)


def manifest_of(path: Path) -> Path:
    """The path of `motions.json` beside a file, else in the folder above, whether or not it exists."""
    beside = path.with_name(MANIFEST)
    return beside if beside.is_file() else path.parent.with_name(MANIFEST)


def read_joints_npy(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one array as positions in metres, turned to y up (`io.body_frame`).

    Raises `FormatError`, with the reason `no-framerate` if no framerate is given.
    """
    manifest = read_manifest(path.parent / MANIFEST)
    fps = options.fps or manifest.fps
    if fps is None:
        message = f'nothing says the framerate; put {{"fps": 30}} into {MANIFEST} beside the file, or use --fps'
        raise FormatError(message, path=path, reason="no-framerate")
    data = source_file.read_bytes(path)
    positions = npy.read_npy(path, data, (None, None, 3), fill_missing=options.fill_missing)
    skeleton = _skeleton(positions.shape[1], manifest, path)
    # Without that file nothing else can state a framerate.
    operations = source_file.replaced_fps(fps, manifest.fps or fps, who=MANIFEST)
    if positions.shape[1] != skeleton.num_joints:
        operations.append(f"kept the first {skeleton.num_joints} of {positions.shape[1]} joints")
        positions = np.ascontiguousarray(positions[:, : skeleton.num_joints])
    unit = options.unit_metres or manifest.unit_metres
    if unit != 1.0:
        positions = positions * np.float32(unit)
        operations.append(f"lengths × {unit:g} to metres (given)")
    positions, lines = upright(skeleton, positions, options.up)
    operations += lines
    stated = "" if manifest.fps is None else str(manifest.fps)
    return source_file.motion_of(
        path, data, "joints-npy", skeleton, fps, operations, positions=positions, stated_fps=stated
    )


def read_humanact12(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one clip as the 22 body joints in metres with its action; raises `FormatError`."""
    fps = options.fps or HUMANACT12_FPS
    motion = read_joints_npy(path, replace(options, fps=fps))
    match = HUMANACT12_NAME.fullmatch(path.stem)
    code = int(match["action"]) if match else 0
    replaced = source_file.replaced_fps(fps, HUMANACT12_FPS, who="the data set")
    provenance = replace(
        motion.provenance,
        source_format="humanact12",
        stated_fps=str(HUMANACT12_FPS),
        subject=match["subject"] if match else "",
        operations=(*motion.provenance.operations, *replaced),
    )
    action = HUMANACT12_ACTIONS[code - 1] if 1 <= code <= len(HUMANACT12_ACTIONS) else ""
    return replace(motion, action=action, provenance=provenance)


def write_joints_npy(motion: Motion, path: Path) -> None:
    """Write the positions in metres and their framerate into `motions.json` beside them.

    Skeletons other than the standard ones are mapped to the 22 joints. Raises `SkeletonMapError` if that fails,
    `ValueError` if the folder's `motions.json` has another framerate or layout.
    """
    if motion.skeleton not in STANDARD_SKELETONS.values():
        motion = Motion(map_joints(motion, SMPL22.name), SMPL22, motion.timegrid)
    manifest = path.parent / MANIFEST
    if manifest.exists():
        folder = read_manifest(manifest)
        if (folder.fps, folder.layout) != (motion.fps, motion.skeleton.name):
            raise ValueError(f"{manifest} says {folder.fps} fps and {folder.layout}; one folder holds one of each")
    else:
        write_json(manifest, {"fps": str(motion.fps), "layout": motion.skeleton.name})
    np.save(path, motion.joint_positions, allow_pickle=False)


def read_manifest(path: Path) -> Manifest:
    """Read `motions.json`; a missing file gives an empty manifest. Raises `FormatError` (`manifest`)."""
    if not path.is_file():
        return Manifest()
    try:
        value = parse_json(source_file.decode(source_file.read_bytes(path), path))
        fps = value.get("fps")
        manifest = Manifest(
            None if fps is None else parse_fps(fps), str(value.get("layout", "")), float(value.get("unit_metres", 1.0))
        )
        if manifest.layout not in ("", *STANDARD_SKELETONS) or not 0 < manifest.unit_metres < 1e6:
            raise ValueError(f"layout {shown(manifest.layout)}, unit_metres {manifest.unit_metres}")
    except (ValueError, TypeError, AttributeError) as error:
        layouts = " or ".join(STANDARD_SKELETONS)
        message = f"expected an object with fps, a layout ({layouts}) and a unit_metres, not {error}"
        raise FormatError(message, path=path, reason="manifest") from None
    return manifest


def _skeleton(num_joints: int, manifest: Manifest, path: Path) -> Skeleton:
    layout = LAYOUT_BY_JOINTS.get(num_joints, "")
    if not layout or manifest.layout not in ("", layout):
        stated = f" for the layout {manifest.layout}" if manifest.layout else ""
        message = f"{num_joints} joints{stated}, expected 22 (smpl22), 24 or 52 (SMPL, SMPL-H) or 21 (kit21)"
        raise FormatError(message, path=path, reason="channel-count")
    return STANDARD_SKELETONS[layout]
