"""CSV tables of Unitree G1's root and 29 hinge angles, z up, x forward; joints by forward kinematics.

BONES-SEED's have a header: Frame, root_translateX (cm), root_rotateX (degrees about the fixed axes x, y, z in turn),
left_hip_pitch_joint_dof (degrees) and so on, at 120 fps (https://github.com/bones-studio/seed-viewer, docs/
models-and-animation.md; https://github.com/NVlabs/ProtoMotions, seed_g1_csv_preparation.rst). Others have none, but 36
numbers a row in metres and radians, mostly at 30 fps: position, quaternion, angles. Kimodo and ARDY write the
quaternion's w first (https://github.com/nv-tlabs/kimodo, output_formats.md), GMR and Unitree's LAFAN1 dataset last.
"""

import re
from fractions import Fraction

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float32
from motionkit.io import body_frame, joints_csv, source_file
from motionkit.io.kimodo import g1
from motionkit.io.registry import FileHead, ReadOptions, SourceItem

SEED_FPS, USUAL_FPS = Fraction(120), Fraction(30)
SEED_ROOT = tuple(f"root_{what}{axis}" for what in ("translate", "rotate") for axis in "XYZ")
NUM_COLUMNS = 36
NUMBER = re.compile(r"\s*[-+]?\d*\.?\d+(e[-+]?\d+)?\s*", re.IGNORECASE)
HINGES = tuple(np.flatnonzero(g1()[2].any(axis=1)).tolist())


def accepts(head: FileHead) -> bool:
    """Whether the first line is BONES-SEED's header, or 36 numbers."""
    names = head.column_names
    return set(SEED_ROOT) <= set(names) or (len(names) == NUM_COLUMNS and all(map(NUMBER.fullmatch, names)))


def local_rotations(
    rotation: Float[np.ndarray, "frames 4"], angles: Float[np.ndarray, "frames 29"]
) -> Float32[np.ndarray, "frames 34 4"]:
    """Local rotations of the robot's joints for the root's rotation and the hinges' angles in radians."""
    skeleton, turns, axes = g1()
    vectors = np.zeros((len(angles), skeleton.num_joints, 3))
    vectors[:, HINGES] = angles[..., None] * axes[list(HINGES)]
    local = kinematics.quaternion_multiply(turns, kinematics.rotation_vector_to_quaternion(vectors))
    local[:, 0] = rotation
    return local.astype(np.float32)


def read_g1_csv(item: SourceItem, options: ReadOptions) -> Motion:
    """Read one table as positions in metres, y up, and local rotations; the format's name says where w stands.

    For `g1-csv` w is where the pelvis is upright; last, if it is upright either way. Raises `FormatError`
    (`channel-count` for missing columns, and what `joints_csv.table` raises).
    """
    path, data = item.path, source_file.read_bytes(item.path)
    names = joints_csv.header(data, path)
    log: list[str] = []
    if SEED_ROOT[0] in names:
        joints = (g1()[0].joint_names[hinge].removesuffix("_skel") for hinge in HINGES)
        columns = (*SEED_ROOT, *(f"{joint}_joint_dof" for joint in joints))
        if absent := [name for name in columns if name not in names]:
            message = f"no column {', '.join(absent[:3])}, expected {', '.join(columns[:7])} …"
            raise FormatError(message, path=path, reason="channel-count", line=1)
        values = joints_csv.table(data, names, path)[:, [names.index(name) for name in columns]]
        usual, root, angles = SEED_FPS, values[:, :3] / 100, np.radians(values[:, 6:])
        rotation = kinematics.euler_to_quaternion(np.radians(values[:, 3:6]), "XYZ", kind="extrinsic")
    else:
        values = joints_csv.table(data, tuple(map(str, range(len(names)))), path, has_header=False)
        if values.shape[1] != NUM_COLUMNS:
            message = f"{values.shape[1]} columns, expected 36: position, quaternion, 29 angles"
            raise FormatError(message, path=path, reason="channel-count", line=1)
        usual, root, rotation, angles = USUAL_FPS, values[:, :3], values[:, 3:7], values[:, 7:]
        # The cosine of the pelvis' tilt is 1 - 2 (q1² + q2²) with w first, and 1 - 2 (q0² + q1²) with w last.
        stands_first = np.mean(rotation[:, 0] ** 2) > np.mean(rotation[:, 2] ** 2)
        first = {"g1-csv-wxyz": True, "g1-csv-xyzw": False}.get(item.format, stands_first)
        rotation = rotation if first else np.roll(rotation, 1, axis=1)
        rotation = rotation / np.maximum(np.linalg.norm(rotation, axis=1, keepdims=True), 1e-9)
        upright = " (the pelvis upright)" if item.format == "g1-csv" else ""
        log.append(f"quaternions' w stands {'first' if first else 'last'}{upright}")
    up, fps = options.up or "z", options.fps or usual
    log += [*body_frame.log_lines(up, options.up), *source_file.replaced_fps(fps, usual, who="the format")]
    local = local_rotations(rotation, angles)
    motion = source_file.motion_of(
        path, data, "g1-csv", g1()[0], fps, log, rotations=local, root=root.astype(np.float32)
    )
    return body_frame.turned(motion, up)
