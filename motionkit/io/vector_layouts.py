"""Pose vectors of models of 2024 to 2026, in .npy files: one table of layouts and one decoder.

HY-Motion: root translation, local rotations, joints relative to the pelvis (https://github.com/Tencent-Hunyuan/
HY-Motion-1.0, hymotion/pipeline/motion_diffusion.py; body_model.py for the pelvis at translation + J₀). motion-135 is
its first 135 numbers; Motius keeps it in .npz files as `motion_135`. DART: translation, local rotations, changes of
both, joints, their steps (https://github.com/zkf1997/DART, utils/smpl_utils.py). ViMoGen's have other slices of the
same width, ARDY's are root, heading, joints, global rotations, velocities, contacts, and Motius' G1 root steps and
height, root rotation, 29 angles (https://github.com/ZeyuLing/Motius, docs/motion/representations.md,
motius/motion/representation, models/ardy). FlowMDM's of BABEL: root height and steps, local rotations
(https://github.com/BarqueroGerman/FlowMDM, data_loaders/amass/transforms/rots2rfeats/globvelandy.py).
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.io import body_frame, g1_csv, joint_rotations, joints_npy, pose_vectors, source_file
from motionkit.io.kimodo import BODIES, g1
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.smpl_body import mean_shape_skeleton

Matrices = Float64[np.ndarray, "frames joints 3 3"]


@dataclass(frozen=True)
class VectorLayout:
    """Where a vector has its positions (metres) and rotations, by the slices' first numbers.

    `joints` (None: rotations on SMPL's mean shape give them) are relative to the pelvis ("root"), to its place on the
    floor, without the pelvis ("floor"), or to nothing ("world"). `rotations` (None: not read) are relative
    to the parent, or to the world if `is_global`: the first two "rows" or "columns" of a matrix one after the other, or
    "pairs", the columns' numbers in turn. `steps` is the first of two numbers that are the root's steps since the frame
    before, not its place; the third of these three is its height. `fps` is None if models of
    several framerates share the layout.
    """

    name: str
    fps: Fraction | None
    skeleton: Skeleton = SMPL22
    up: str = "y"
    joints: int | None = None
    relative_to: Literal["root", "floor", "world"] = "world"
    rotations: int | None = None
    form: Literal["rows", "columns", "pairs"] = "pairs"
    is_global: bool = False
    steps: int | None = None


_LAYOUTS = (
    VectorLayout("hymotion-201", Fraction(30), joints=135, relative_to="root", rotations=3),
    VectorLayout("motion-135", Fraction(30), rotations=3),
    VectorLayout("flowmdm-135", Fraction(30), up="z", rotations=3, form="rows", steps=1),
    VectorLayout("dart-276", None, up="z", joints=144, rotations=3, form="rows"),
    VectorLayout("vimogen-276", None, up="z", joints=126),
    VectorLayout("ardy-330", Fraction(20), BODIES["ardy-core27"], "y", 5, "floor", 83, "columns", is_global=True),
    VectorLayout("ardy-g1-414", None, g1()[0], joints=5, relative_to="floor"),
    VectorLayout("g1-38", Fraction(30), g1()[0], up="z", rotations=3, steps=0),
)


LAYOUTS = {layout.name: layout for layout in _LAYOUTS}
# By the name of the format.
LAYOUTS["motius"] = LAYOUTS["motion-135"]


def read_vectors(item: SourceItem, options: ReadOptions) -> Motion:
    """Read one file as positions in metres, y up, and local rotations if these reproduce the positions.

    Raises `FormatError`: `no-framerate` where the layout has none, `unit` for normalised vectors.
    """
    path, layout = item.path, LAYOUTS[item.format]
    data = source_file.read_bytes(path)
    values = pose_vectors.rows_of(path, data, options)
    usual = layout.fps or options.fps or joints_npy.read_manifest(joints_npy.manifest_of(path)).fps
    if usual is None:
        message = f"{layout.name} vectors have no framerate; give --fps (DART: 30 on BABEL, 20 on HumanML3D)"
        raise FormatError(message, path=path, reason="no-framerate")
    skeleton, matrices, root = layout.skeleton, None, values[:, :3]
    if layout.steps is not None:
        root = np.roll(root, -layout.steps, axis=1)
        root[:, :2] = np.cumsum(root[:, :2], axis=0)
    if layout.rotations is not None:
        count = 1 if layout.name == "g1-38" else skeleton.num_joints
        sixes = values[:, layout.rotations : layout.rotations + 6 * count]
        matrices = joint_rotations.matrices_of(sixes, layout.form, path)
    if layout.name == "g1-38" and matrices is not None:
        local = g1_csv.local_rotations(kinematics.matrix_to_quaternion(matrices[:, 0]), values[:, 9:])
        matrices = kinematics.quaternion_to_matrix(local)
        positions = kinematics.forward_kinematics(local, root, skeleton)
    else:
        positions = _positions(values, root, layout, matrices)
    if skeleton is not SMPL22:
        skeleton = replace(skeleton, offsets=positions[0] - positions[0, skeleton.parents_or_self])
    positions = positions * np.float32(options.unit_metres or 1.0)
    up = options.up or layout.up
    lines = body_frame.log_lines(up, options.up)
    motion = pose_vectors.motion_of(path, data, positions, skeleton, usual, layout.name, options, *lines)
    if matrices is not None:
        motion = joint_rotations.with_rotations(motion, matrices, is_global=layout.is_global)
    return body_frame.turned(motion, up)


def _positions(
    values: Float32[np.ndarray, "frames numbers"],
    root: Float32[np.ndarray, "frames 3"],
    layout: VectorLayout,
    matrices: Matrices | None,
) -> Float32[np.ndarray, "frames joints 3"]:
    frames, num_joints = len(values), layout.skeleton.num_joints
    # SMPL's pelvis rests at J₀; ARDY's root is the pelvis itself.
    root = root[:, None] + mean_shape_skeleton().offsets[0] * (layout.relative_to != "floor")
    if layout.joints is None:
        assert matrices is not None
        rotations = kinematics.matrix_to_quaternion(matrices)
        return kinematics.forward_kinematics(rotations, root[:, 0], mean_shape_skeleton()).astype(np.float32)
    count = num_joints - (layout.relative_to == "floor")
    joints = values[:, layout.joints : layout.joints + 3 * count].reshape(frames, count, 3)
    match layout.relative_to:
        case "root":
            joints = joints + root
        case "floor":
            joints = np.concatenate((root, joints + root * (1, 0, 1)), axis=1)
    return joints.astype(np.float32)
