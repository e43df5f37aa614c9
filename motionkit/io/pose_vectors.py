"""Pose vectors in single .npy files: HumanML3D's and KIT-ML's, InterHuman's, MotionStreamer's.

HumanML3D's 263 numbers and KIT-ML's 251 are those of `formats.humanml3d`. InterHuman's 262 are positions of SMPL's 22
joints in the scene (66), their velocities (66), rotations of 21 joints (126, without the root's), four contacts; two
persons are [T, 2, 262] or [T, 524]; the data set's files have 492 numbers, the positions of 62 joints first, z up
(https://github.com/tr3e/InterGen, utils/utils.py, utils/preprocess.py). MotionStreamer's 272 are the root's velocity in
x and z (2) and the yaw since the previous frame as a rotation (6), positions (66) and velocities (66) of the 22 joints
relative to the root's floor projection and the body's heading, and SMPL's local rotations (132), the root's without
heading; a rotation is the first two rows of its matrix (https://github.com/Li-xingXiao/272-dim-Motion-Representation,
representation_272.py).
"""

from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.io import body_frame, humanml3d, joint_rotations, joints_npy, npy, source_file
from motionkit.io.body_frame import upright
from motionkit.io.humanml3d import LAYOUTS
from motionkit.io.registry import FileHead, ReadOptions, SourceItem

Positions = Float32[np.ndarray, "frames joints 3"]

LAYOUT_BY_WIDTH = {layout.num_values: layout for layout in LAYOUTS.values()}
INTERHUMAN_WIDTH = 262
INTERHUMAN_ROWS = ((INTERHUMAN_WIDTH,), (2, INTERHUMAN_WIDTH), (2 * INTERHUMAN_WIDTH,), (492,))
FPS = Fraction(30)
PERSONS = ("person1", "person2")
JOINTS = SMPL22.num_joints
# MotionStreamer's: path, yaw, positions, rotations.
PATH, YAW = slice(0, 2), slice(2, 8)
PLACES, TURNS = slice(8, 8 + 3 * JOINTS), slice(8 + 6 * JOINTS, 8 + 12 * JOINTS)
MOTIUS_KEY = "motion_135"


def is_interhuman(head: FileHead) -> bool:
    """Whether rows of a .npy file have 262 numbers for one or two persons, or the data set's 492."""
    return (head.array_shape or ())[1:] in INTERHUMAN_ROWS


def persons(head: FileHead) -> tuple[str, ...]:
    """The persons' keys in an InterHuman file with two persons; empty for one."""
    shape = head.array_shape or ()
    return PERSONS if len(shape) == 3 or shape[1:] == (2 * INTERHUMAN_WIDTH,) else ()


def read_pose_vectors(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read HumanML3D's or KIT-ML's vectors as joint positions in metres; normalised ones are refused.

    The framerate is the data set's unless `options`, or a `motions.json` there or one folder above, gives another.
    """
    data = source_file.read_bytes(path)
    vectors = rows_of(path, data, options)
    layout = LAYOUT_BY_WIDTH[vectors.shape[1]]
    positions = humanml3d.recover_positions(vectors, layout.skeleton.num_joints)
    positions = positions * np.float32(options.unit_metres or layout.unit_metres)
    line = f"joint positions recovered from {layout.num_values}-number pose vectors"
    return motion_of(path, data, positions, layout.skeleton, layout.fps, layout.name, options, line)


def read_interhuman(item: SourceItem, options: ReadOptions) -> Motion:
    """Read one person of InterHuman's vectors: joint positions in metres, y up, in scene coordinates."""
    path, data = item.path, source_file.read_bytes(item.path)
    values = npy.read_npy(path, data, None, fill_missing=options.fill_missing)
    if values.shape[1:] not in INTERHUMAN_ROWS:
        message = f"array of shape {values.shape}, expected rows of 262, 2 × 262 or 492 numbers"
        raise FormatError(message, path=path, reason="channel-count")
    rows = values.reshape(len(values), -1)
    start = INTERHUMAN_WIDTH * PERSONS.index(item.key) if item.key else 0
    positions = rows[:, start : start + 3 * JOINTS].reshape(len(rows), JOINTS, 3)
    positions, lines = upright(SMPL22, positions * np.float32(options.unit_metres or 1.0), options.up)
    return motion_of(path, data, positions, SMPL22, FPS, "interhuman", options, *lines)


def read_motionstreamer(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read MotionStreamer's vectors: positions in metres, y up, and SMPL's local rotations if they reproduce them.

    Yaw and path are integrated from the first frame, so errors accumulate. Raises `FormatError` (`unit`) for normalised
    vectors.
    """
    data = source_file.read_bytes(path)
    values = rows_of(path, data, options).astype(np.float64)
    # Vectors are relative to the heading: rotating by minus the yaw gives world coordinates.
    yaw = np.cumsum(np.arctan2(values[:, YAW][:, 2], values[:, YAW][:, 0]))
    back = np.stack((np.cos(-yaw / 2), 0 * yaw, np.sin(-yaw / 2), 0 * yaw), axis=-1)
    steps = np.insert(values[:, PATH], 1, 0.0, axis=1)
    path_steps = np.concatenate((steps[:1], kinematics.quaternion_rotate(back[:-1], steps[1:])))
    relative = values[:, PLACES].reshape(len(values), JOINTS, 3)
    positions = kinematics.quaternion_rotate(back[:, None], relative) + np.cumsum(path_steps, axis=0)[:, None]
    local = joint_rotations.matrices_of(values[:, TURNS], "rows", path)
    local[:, 0] = kinematics.quaternion_to_matrix(back) @ local[:, 0]
    positions = positions.astype(np.float32) * np.float32(options.unit_metres or 1.0)
    motion = motion_of(path, data, positions, SMPL22, FPS, "motionstreamer", options)
    return joint_rotations.with_rotations(motion, local)


def rows_of(path: Path, data: bytes, options: ReadOptions) -> Float32[np.ndarray, "frames numbers"]:
    """The vectors of a .npy file, [T, D] or [1, T, D], or of Motius' .npz."""
    if path.suffix.lower() == ".npz":
        return npy.open_archive(path, data).numbers(MOTIUS_KEY, (None, 135), fill_missing=options.fill_missing)
    values = npy.read_npy(path, data, None, fill_missing=options.fill_missing)
    return values.reshape(-1, values.shape[-1])


def motion_of(
    path: Path,
    data: bytes,
    positions: Positions,
    skeleton: Skeleton,
    usual_fps: Fraction,
    source_format: str,
    options: ReadOptions,
    *operations: str,
) -> Motion:
    """The motion of positions that vectors gave; raises `FormatError` (`unit`) for bodies of no person's size."""
    metres = body_frame.standing_metres(skeleton, positions)
    if not body_frame.is_plausible(metres):
        message = f"these vectors make a body of {metres:.3g} m from ankle to head: multiply normalised ones by the "
        raise FormatError(f"{message}std of the model that made them, and add its mean", path=path, reason="unit")
    stated = joints_npy.read_manifest(joints_npy.manifest_of(path)).fps or usual_fps
    fps = options.fps or stated
    lines = (*operations, *source_file.replaced_fps(fps, usual_fps, who="the data set"))
    return source_file.motion_of(
        path, data, source_format, skeleton, fps, lines, positions=positions, stated_fps=str(stated)
    )
