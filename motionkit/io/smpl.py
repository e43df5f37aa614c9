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
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import Skeleton
from motionkit.io import npy, source_file
from motionkit.io.amass import FRAMERATE_KEYS, check_radians, framerate_of
from motionkit.io.joint_rotations import MAX_MATRIX_ERROR
from motionkit.io.registry import FileHead, ReadOptions
from motionkit.io.smpl_body import BODY, SMPL, SMPLX, posed_motion, posed_skeleton

Rotations = Float32[np.ndarray, "frames joints 4"]

WORLD, ORIENT, POSE = "pose_world", "global_orient", "body_pose"
TRANSLATIONS = ("transl", "trans", "trans_world")
LAYOUTS = {BODY.num_joints: BODY, SMPL.num_joints: SMPL}
# Motion-X: its width, and the slices that are read.
WIDTH, BODY_NUMBERS, TRANSLATION, BETAS = 322, slice(0, 66), slice(309, 312), slice(312, 322)
MOTION_X_FPS = Fraction(30)


def accepts(head: FileHead) -> bool:
    """Whether an .npz file is such a dictionary, judged by its names."""
    return {ORIENT, POSE} <= head.array_names or WORLD in head.array_names


def read_smpl(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one dictionary: true local rotations, positions in metres, y up (up is inferred from the body: y, z or −y).

    Without a body model the joints are those of SMPL's mean shape; hands and face are dropped. Raises `FormatError`,
    with the reason `no-framerate` if neither the file nor the options give one.
    """
    data = source_file.read_bytes(path)
    archive = npy.open_archive(path, data)
    if WORLD in archive:
        rotations = _rotations(archive, WORLD)
    else:
        root, body = _rotations(archive, ORIENT, 1), _rotations(archive, POSE)
        if len(root) != len(body):
            raise _wrong(path, f"{len(root)} frames of {ORIENT} and {len(body)} of {POSE}")
        rotations = np.concatenate((root, body), axis=1)
    if rotations.shape[1] not in LAYOUTS:
        known = " or ".join(map(str, LAYOUTS))
        raise _wrong(path, f"rotations of {rotations.shape[1]} joints, expected {known}, pelvis included")
    key = next((key for key in TRANSLATIONS if key in archive), None)
    translation = None if key is None else _values(archive, key)
    if translation is not None and (translation.size != 3 * len(rotations) or translation.shape[-1] != 3):
        raise _wrong(path, f"{key}: array of shape {translation.shape}, expected ({len(rotations)}, 3)")
    betas = np.zeros(0, np.float32)
    if "betas" in archive:  # of all frames, of a body or of a batch
        betas = _values(archive, "betas")
        betas = betas.reshape(-1, betas.shape[-1])[0]
    advice = "--fps gives the video's (GVHMR's results have 30)"
    fps, stated, lines = framerate_of(archive, ("fps", *FRAMERATE_KEYS), options, advice)
    source = source_file.provenance(path, data, "smpl", lines, stated_fps=stated)
    return posed_motion(
        rotations, translation, neutral_body(rotations.shape[1], betas, options), fps, options.up, source
    )


def read_motion_x(path: Path, options: ReadOptions = ReadOptions()) -> Motion:
    """Read one sequence of Motion-X at its 30 fps: the body's true local rotations; hands and face are dropped."""
    data = source_file.read_bytes(path)
    values = npy.read_npy(path, data, (None, WIDTH))
    rotations = _of_vectors(values[:, BODY_NUMBERS].reshape(len(values), -1, 3), path, "its first 66 numbers")
    fps, lines = source_file.fps_in_use(options.fps, lambda: MOTION_X_FPS, who="the data set")
    source = source_file.provenance(path, data, "motion-x", lines, stated_fps=str(MOTION_X_FPS))
    body = neutral_body(BODY.num_joints, values[0, BETAS], options)
    return posed_motion(rotations, values[:, TRANSLATION], body, fps, options.up, source)


def _values(archive: npy.Archive, key: str) -> Float32[np.ndarray, "..."]:
    """An array of numbers of any shape, but not a scalar."""
    values = archive.numbers(key, None)
    if not values.shape:
        raise _wrong(archive.path, f"{key}: a single number, expected an array")
    return values


def _rotations(archive: npy.Archive, key: str, num_joints: int | None = None) -> Rotations:
    """Rotations of a key as quaternions, from rotation vectors or matrices, in a batch of one or not."""
    values = _values(archive, key)
    # For several joints, [1, joints, 3] is one frame, and [1, 3, 3] is a matrix.
    of_frames = values.shape[-1] > 3 or (num_joints == 1 and values.shape[1:] != (3, 3))
    if values.ndim == 3 and len(values) == 1 and values.shape[-1] % 3 == 0 and of_frames:
        values = values[0]
    frames = len(values)
    # For one joint, [3, 3] is three frames of vectors; for several, [frames, 3, 3] is three joints' vectors.
    if values.shape[-2:] == (3, 3) and values.ndim in ((4,) if num_joints is None else (3, 4)):
        matrices = values.reshape(frames, -1, 3, 3)
        error = np.abs(np.einsum("tjki,tjkl->tjil", matrices, matrices) - np.eye(3)).max()
        if error > MAX_MATRIX_ERROR:
            message = f"{key}: a matrix is off a rotation by {error:.2g}, expected rotation matrices"
            raise FormatError(message, path=archive.path, reason="range")
        rotations: Rotations = kinematics.matrix_to_quaternion(matrices).astype(np.float32)
    elif values[0].size % 3 == 0 and (values.ndim == 2 or values.shape[-1] == 3):
        rotations = _of_vectors(values.reshape(frames, -1, 3), archive.path, key)
    else:
        raise _wrong(archive.path, f"{key}: array of shape {values.shape}, expected rotation vectors or matrices")
    if num_joints is not None and rotations.shape[1] != num_joints:
        raise _wrong(archive.path, f"{key}: rotations of {rotations.shape[1]} joints a frame, expected {num_joints}")
    return rotations


def _of_vectors(vectors: Float32[np.ndarray, "frames joints 3"], path: Path, key: str) -> Rotations:
    check_radians(vectors, path, key)
    return kinematics.rotation_vector_to_quaternion(vectors)


def _wrong(path: Path, message: str) -> FormatError:
    return FormatError(message, path=path, reason="channel-count")


def neutral_body(
    num_joints: int, betas: Float32[np.ndarray, "betas"], options: ReadOptions
) -> tuple[Skeleton, list[str]]:
    """The neutral body of poses of 22 or 24 joints (`posed_skeleton`)."""
    layout = LAYOUTS[num_joints]
    return posed_skeleton(options.body_models, layout, SMPLX if layout is BODY else SMPL, "neutral", betas)
