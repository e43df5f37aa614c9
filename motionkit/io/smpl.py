"""Dictionaries of SMPL's parameters as systems that estimate or generate motion save them, in .npz; Motion-X's .npy.

`global_orient` and `body_pose` hold rotation vectors (3 numbers a joint) or matrices (3 × 3) of the pelvis and of the
21 joints of SMPL-X's body or the 23 of SMPL's; `transl` the translation, with the pelvis at transl + J₀; `betas` the
shape. WHAM's world has them as `pose_world` (72 numbers) and `trans_world`. The names are those of the smplx package
(https://github.com/vchoutas/smplx), GVHMR (https://github.com/zju3dv/GVHMR), 4D-Humans
(https://github.com/shubham-goel/4D-Humans) and WHAM (https://github.com/yohanshin/WHAM). Motion-X's 322 numbers a frame
are root 3, body 63, hands 90, jaw 3, expression 50, face shape 100, translation 3, betas 10
(https://github.com/IDEA-Research/Motion-X).
"""

from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.framerate import parse_fps
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.io import npy, up
from motionkit.io.amass import FRAMERATE_KEYS, MAX_RADIANS
from motionkit.io.registry import FileHead, Format, ReadOptions, of_path
from motionkit.io.smpl_body import BODY, SMPL, SMPLX, PoseLayout, mean_body, own_body
from motionkit.io.source import clock, source_file
from motionkit.io.source.rigid import MAX_MATRIX_ERROR

WORLD, ORIENT, POSE = "pose_world", "global_orient", "body_pose"
TRANSLATIONS = ("transl", "trans", "trans_world")
RATES = ("fps", *FRAMERATE_KEYS)
LAYOUTS = {BODY.num_joints: BODY, SMPL.num_joints: SMPL}
# Motion-X: its width, and the slices that are read.
WIDTH, BODY_NUMBERS, MOVED, SHAPE = 322, slice(0, 66), slice(309, 312), slice(312, 322)
MOTION_X_FPS = Fraction(30)


def accepts(head: FileHead) -> bool:
    """Whether an .npz file is such a dictionary, judged by its names."""
    return {ORIENT, POSE} <= head.array_names or WORLD in head.array_names


def read_smpl(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one dictionary: true local rotations, positions in metres, y up (up is inferred from the body: y, z or −y).

    Without a body model the joints are those of SMPL's mean shape; hands and face are dropped. Raises `FormatError`,
    with the reason `no-framerate` if neither the file nor the options give one.
    """
    options = options or ReadOptions()
    data = source_file.read_bytes(path)
    archive = npy.open_archive(path, data)
    if WORLD in archive:
        rotations = _rotations(archive, WORLD)
    else:
        rotations = _whole(_rotations(archive, ORIENT, 1), _rotations(archive, POSE), path)
    layout = LAYOUTS.get(rotations.shape[1])
    if layout is None:
        message = (
            f"rotations of {rotations.shape[1]} joints, expected {' or '.join(map(str, LAYOUTS))}, pelvis included"
        )
        raise FormatError(message, path=path, reason="channel-count")
    key = next((key for key in TRANSLATIONS if key in archive), None)
    moved = None if key is None else _translation(archive, key, len(rotations))
    fps, stated, operations = _framerate(archive, options)
    betas = _values(archive, "betas") if "betas" in archive else None
    shape = np.zeros(0, np.float32) if betas is None else np.atleast_2d(betas).reshape(-1, betas.shape[-1])[0]
    motion = _motion(rotations, moved, layout, shape, fps, options)
    source = source_file.provenance(path, data, "smpl", (*operations, *motion.provenance.operations), stated_fps=stated)
    return Motion(
        motion.joint_positions, motion.skeleton, motion.timegrid, motion.local_rotations, motion.root_translation,
        sequence_id=path.stem, provenance=source,
    )  # fmt: skip


def _whole(
    root: Float32[np.ndarray, "frames 1 4"], body: Float32[np.ndarray, "body_frames joints 4"], path: Path
) -> Float32[np.ndarray, "frames all_joints 4"]:
    if len(root) != len(body):
        message = f"{len(root)} frames of {ORIENT} and {len(body)} of {POSE}"
        raise FormatError(message, path=path, reason="channel-count")
    return np.concatenate((root, body), axis=1)


def _values(archive: npy.Archive, key: str) -> Float32[np.ndarray, "..."]:
    """An array of numbers of any shape, but not a scalar."""
    values = archive.numbers(key, None)
    if not values.shape:
        raise FormatError(f"{key}: a single number, expected an array", path=archive.path, reason="channel-count")
    return values


def _rotations(archive: npy.Archive, key: str, num_joints: int | None = None) -> Float32[np.ndarray, "frames joints 4"]:
    """Rotations of a key as quaternions, from rotation vectors or matrices."""
    values = _values(archive, key)
    # For several joints, [1, joints, 3] is one frame, and [1, 3, 3] is a matrix.
    of_frames = values.shape[-1] > 3 or (num_joints == 1 and values.shape[1:] != (3, 3))
    if values.ndim == 3 and len(values) == 1 and values.shape[-1] % 3 == 0 and of_frames:
        values = values[0]  # one body of a batch
    frames, size = len(values), values[0].size
    # For one joint, [3, 3] is three frames of vectors; for several, [frames, 3, 3] is three joints' vectors.
    if values.shape[-2:] == (3, 3) and values.ndim in ((4,) if num_joints is None else (3, 4)):
        matrices = values.reshape(frames, -1, 3, 3)
        error = np.abs(np.einsum("tjki,tjkl->tjil", matrices, matrices) - np.eye(3)).max()
        if error > MAX_MATRIX_ERROR:
            message = f"{key}: a matrix is off a rotation by {error:.2g}, expected rotation matrices"
            raise FormatError(message, path=archive.path, reason="range")
        quaternions: Float32[np.ndarray, "frames joints 4"] = kinematics.matrix_to_quaternion(matrices).astype(
            np.float32
        )
    elif size % 3 == 0 and (values.ndim == 2 or values.shape[-1] == 3):
        quaternions = _of_vectors(values.reshape(frames, -1, 3), archive.path, key)
    else:
        message = f"{key}: array of shape {values.shape}, expected rotation vectors or matrices of all frames"
        raise FormatError(message, path=archive.path, reason="channel-count")
    if num_joints is not None and quaternions.shape[1] != num_joints:
        message = f"{key}: rotations of {quaternions.shape[1]} joints a frame, expected {num_joints}"
        raise FormatError(message, path=archive.path, reason="channel-count")
    return quaternions


def _of_vectors(
    vectors: Float32[np.ndarray, "frames joints 3"], path: Path, key: str
) -> Float32[np.ndarray, "frames joints 4"]:
    largest = np.abs(vectors).max(axis=(1, 2))
    if largest.max() > MAX_RADIANS:
        frame = int(np.argmax(largest > MAX_RADIANS))
        message = f"{key}: {largest[frame]:.4g} where a rotation vector in radians was expected; are these degrees?"
        raise FormatError(message, path=path, reason="radians", frame=frame)
    return kinematics.rotation_vector_to_quaternion(vectors)


def _translation(archive: npy.Archive, key: str, num_frames: int) -> Float32[np.ndarray, "frames 3"]:
    values = _values(archive, key)
    if values.size != 3 * num_frames or values.shape[-1] != 3:
        message = f"{key}: array of shape {values.shape}, expected ({num_frames}, 3)"
        raise FormatError(message, path=archive.path, reason="channel-count")
    return values.reshape(num_frames, 3)


def _framerate(archive: npy.Archive, options: ReadOptions) -> tuple[Fraction, str, list[str]]:
    key = next((key for key in RATES if key in archive), None)
    value = None if key is None else archive.scalar(key)

    def stated() -> Fraction:
        try:
            if value is None:
                raise ValueError("no number")
            return parse_fps(value)
        except ValueError as error:
            message = f"nothing says the framerate ({error}): use --fps, the video's (GVHMR's results have 30)"
            reason = "no-framerate" if key is None else "framerate"
            raise FormatError(message, path=archive.path, reason=reason) from None

    fps, operations = clock.fps_in_use(options.fps, stated)
    return fps, "" if value is None else str(value), operations


def _motion(
    rotations: Float32[np.ndarray, "frames joints 4"],
    translation: Float32[np.ndarray, "frames 3"] | None,
    layout: PoseLayout,
    betas: Float32[np.ndarray, "betas"],
    fps: Fraction,
    options: ReadOptions,
) -> Motion:
    """The motion of a body, rotated to y up; decisions are in its log."""
    if options.body_models is None:
        body = mean_body(layout)
    else:
        body = own_body(options.body_models, layout, SMPLX if layout is BODY else SMPL, "neutral", betas)
    operations = list(body.operations)
    if translation is None:
        operations.append("no translation in the file: the pelvis stays in place")
        translation = np.zeros((len(rotations), 3), np.float32)
    local = rotations[:, : body.skeleton.num_joints].copy()
    root = translation + body.skeleton.offsets[0]
    positions = kinematics.forward_kinematics(local, root, body.skeleton)
    axis = options.up or up.infer_up(SMPL22, positions[:, : SMPL22.num_joints], ("y", "z", "-y"))
    made = up.turned(Motion(positions, body.skeleton, TimeGrid(fps, len(local)), local, root), axis)
    for line in (*operations, *up.log_lines(axis, options.up)):
        made = made.logged(line)
    return made


def accepts_motion_x(head: FileHead) -> bool:
    """Whether a .npy file has Motion-X's 322 numbers per frame."""
    shape = head.array_shape
    return shape is not None and len(shape) == 2 and shape[1] == WIDTH


def read_motion_x(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one sequence of Motion-X at its 30 fps: the body's true local rotations; hands and face are dropped."""
    options = options or ReadOptions()
    data = source_file.read_bytes(path)
    values = npy.read_npy(path, data, (None, WIDTH))
    rotations = _of_vectors(values[:, BODY_NUMBERS].reshape(len(values), -1, 3), path, "its first 66 numbers")
    fps = options.fps or MOTION_X_FPS
    motion = _motion(rotations, values[:, MOVED], BODY, values[0, SHAPE], fps, options)
    lines = (*motion.provenance.operations, *clock.replaced_fps(fps, MOTION_X_FPS, who="the data set"))
    source = source_file.provenance(path, data, "motion-x", lines, stated_fps=str(MOTION_X_FPS))
    return Motion(
        motion.joint_positions, motion.skeleton, motion.timegrid, motion.local_rotations, motion.root_translation,
        sequence_id=path.stem, provenance=source,
    )  # fmt: skip


FORMAT = Format(name="smpl", read=of_path(read_smpl), suffixes=(".npz",), accepts=accepts, turns_up=True)

MOTION_X_FORMAT = Format(
    name="motion-x", read=of_path(read_motion_x), suffixes=(".npy",), accepts=accepts_motion_x, turns_up=True
)
