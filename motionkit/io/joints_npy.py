"""Joint positions in .npy files [T, J, 3], with the framerate from `motions.json`, an annotation CSV or an option.

`motions.json` beside the files has the form `{"fps": "30000/1001", "layout": "smpl22", "unit_metres": 1.0}`; without it
the layout follows from J: 22, 24 and 52 joints are SMPL's (SMPL-H's 30 hand joints are dropped), 21 are KIT's.
"""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.files import write_json
from motionkit.core.framerate import format_fps, parse_fps
from motionkit.core.motion import Motion
from motionkit.core.plain_text import parse_json, shown
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS, Skeleton
from motionkit.core.skeletons.mapping import map_joints
from motionkit.core.timegrid import TimeGrid
from motionkit.io import npy, source_file
from motionkit.io.body_frame import upright
from motionkit.io.registry import FileHead, Format, ReadOptions, of_path

MANIFEST = "motions.json"
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


def manifest_of(path: Path) -> Path:
    """The path of `motions.json` beside a file, else in the folder above, whether or not it exists."""
    beside = path.with_name(MANIFEST)
    return beside if beside.is_file() else path.parent.with_name(MANIFEST)


def read_joints_npy(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one array as positions in metres, turned to y up (`io.body_frame`).

    Raises `FormatError`, with the reason `no-framerate` if no framerate is given.
    """
    options = options or ReadOptions()
    manifest = read_manifest(path.parent / MANIFEST)
    fps = options.fps or manifest.fps
    if fps is None:
        of_humanml3d = (
            "; of HumanML3D name the folder above, whose framerate is known" if path.parent.name == "new_joints" else ""
        )
        raise FormatError(
            f'nothing says the framerate; put {{"fps": 30}} into {MANIFEST} beside the file, a column fps into an '
            f"annotation CSV, or use --fps{of_humanml3d}",
            path=path,
            reason="no-framerate",
        )
    data = source_file.read_bytes(path)
    positions = npy.read_npy(path, data, (None, None, 3))
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
    positions, turned = upright(skeleton, positions, options.up)
    operations += turned
    return Motion(
        joint_positions=positions,
        skeleton=skeleton,
        timegrid=TimeGrid(fps, len(positions)),
        sequence_id=path.stem,
        provenance=source_file.provenance(
            path, data, "joints-npy", operations, stated_fps="" if manifest.fps is None else format_fps(manifest.fps)
        ),
    )


def write_joints_npy(motion: Motion, path: Path) -> None:
    """Write the positions in metres and their framerate into `motions.json` beside them.

    Skeletons other than the standard ones are mapped to the 22 joints. Raises `SkeletonMapError` if that fails,
    `ValueError` if the folder's `motions.json` has another framerate or layout.
    """
    if motion.skeleton not in STANDARD_SKELETONS.values():
        motion = Motion(map_joints(motion, SMPL22.name), SMPL22, motion.timegrid)
    manifest = path.parent / MANIFEST
    if manifest.exists():
        there = read_manifest(manifest)
        if (there.fps, there.layout) != (motion.fps, motion.skeleton.name):
            raise ValueError(f"{manifest} says {there.fps} fps and {there.layout}; one folder holds one of each")
    else:
        write_json(manifest, {"fps": format_fps(motion.fps), "layout": motion.skeleton.name})
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
    except (ValueError, TypeError, AttributeError) as error:
        raise FormatError(f"expected an object with fps and layout ({error})", path=path, reason="manifest") from None
    if manifest.layout not in ("", *STANDARD_SKELETONS) or not 0 < manifest.unit_metres < 1e6:
        raise FormatError(
            f"layout {shown(manifest.layout)} and unit {manifest.unit_metres} m, expected one of "
            f"{', '.join(STANDARD_SKELETONS)} and a length",
            path=path,
            reason="manifest",
        )
    return manifest


def _skeleton(num_joints: int, manifest: Manifest, path: Path) -> Skeleton:
    layout = manifest.layout or LAYOUT_BY_JOINTS.get(num_joints, "")
    if layout not in STANDARD_SKELETONS or LAYOUT_BY_JOINTS.get(num_joints) != layout:
        raise FormatError(
            f"{num_joints} joints{f' for the layout {layout}' if layout else ''}, expected 22 (smpl22), 24 or 52 "
            "(SMPL or SMPL-H with hands) or 21 (kit21)",
            path=path,
            reason="channel-count",
        )
    return STANDARD_SKELETONS[layout]


FORMAT = Format(
    name="joints-npy",
    read=of_path(read_joints_npy),
    suffixes=(".npy",),
    accepts=accepts,
    beside=(MANIFEST,),
    begins=npy.MAGIC,
    write=write_joints_npy,
    turns_up=True,
    shared_file=MANIFEST,
)
