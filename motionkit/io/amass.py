"""AMASS motions (.npz): SMPL, SMPL-H and SMPL-X poses as axis–angle vectors, z up, with the subject's shape.

Systems that write this form may have y up (HY-Motion): the motion tells (`io.body_frame`).

The pelvis is at trans + J₀, where J₀ is its rest position for the subject's betas, and the centre of the root rotation.
Sources: https://github.com/nghorbani/amass (arrays, notebooks) and the file listings of its issues 8, 49 and 68 (names
of the two generations of files); Loper et al., "SMPL: A Skinned Multi-Person Linear Model", 2015, Eq. 2–4 and 10
(joints).
"""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import parse_fps
from motionkit.io import body_frame, npy, source_file
from motionkit.io.registry import FileHead, ReadOptions, SourceItem
from motionkit.io.retargeting import retarget
from motionkit.io.smpl_body import (
    BODY,
    LAYOUTS,
    POSE_PARTS,
    SMPLH,
    SMPLX,
    PoseLayout,
    mean_shape_skeleton,
    posed_motion,
    posed_skeleton,
    rests_as_smpl,
)

MOTION_NAMES = ("_poses", "_stageii")
FRAMERATE_KEYS = ("mocap_framerate", "mocap_frame_rate")
PUBLISHED_BETAS = 10
# Eight turns.
MAX_RADIANS = 50.0
# The default number of betas of smplx.create, which GMR uses.
WRITTEN_BETAS = 10
GENDERS = ("male", "female", "neutral")


def accepts(head: FileHead) -> bool:
    """Whether an .npz file is an AMASS motion, not a shape beside one (`shape.npz`, `…_stagei.npz`)."""
    stem = head.path.stem
    if stem == "shape" or stem.endswith("_stagei"):
        return False
    if stem.endswith(MOTION_NAMES):
        return True
    keys = head.array_names
    return "trans" in keys and ("poses" in keys or {"root_orient", "pose_body"} <= keys)


def read_amass(item: SourceItem, options: ReadOptions) -> Motion:
    """Read one motion at its stated framerate: true local rotations, positions in metres, turned from z up to y up.

    Without a body model the joints are the 22 of SMPL's mean shape, and finger, jaw and eye rotations are dropped.
    Raises `FormatError`, with the reason `no-framerate` if none is stated, `framerate` if it is invalid.
    """
    path = item.path
    data = source_file.read_bytes(path)
    archive = npy.open_archive(path, data)
    family = archive.text("surface_model_type").strip().lower().split("_")[0]  # without a variant: "smplx_locked_head"
    poses, layout = _read_poses(archive, family)
    trans = archive.numbers("trans", (len(poses), 3))
    fps, stated, operations = framerate_of(archive, FRAMERATE_KEYS, options, "--fps-rules or --fps gives it")
    body = _skeleton(archive, layout, LAYOUTS.get(family, SMPLH), options)
    vectors = poses[:, : 3 * body[0].num_joints].reshape(len(poses), -1, 3)
    rotations = kinematics.rotation_vector_to_quaternion(vectors)
    subject = "" if path.parent == item.root else path.parent.name
    source = source_file.provenance(path, data, "amass", operations, stated_fps=stated, subject=subject)
    return posed_motion(rotations, trans, body, fps, options.up, source, axes=("z", "y"))


def _read_poses(archive: npy.Archive, family: str) -> tuple[Float32[np.ndarray, "frames values"], PoseLayout]:
    """The poses in one array, and the joints that they turn; `family` is the stated body model or empty."""
    if "poses" in archive:
        poses = archive.numbers("poses", (None, None))
    else:
        root = archive.numbers("root_orient", (None, 3))
        present = [(key, size) for key, size in POSE_PARTS[1:] if key in archive or key == "pose_body"]
        poses = np.concatenate((root, *(archive.numbers(key, (len(root), size)) for key, size in present)), axis=1)
    check_radians(poses, archive.path, "poses")
    for layout in (*LAYOUTS.values(), BODY):
        if poses.shape[1] == 3 * layout.num_joints and (layout is BODY or family in ("", layout.family)):
            return poses, layout
    widths = ", ".join(f"{3 * layout.num_joints} ({name})" for name, layout in LAYOUTS.items())
    stated = f" for the body model {family[:20]!r}" if family else ""
    message = f"poses of {poses.shape[1]} numbers{stated}, expected {widths} or {3 * BODY.num_joints} (body only)"
    raise FormatError(message, path=archive.path, reason="channel-count")


def check_radians(vectors: Float32[np.ndarray, "frames *values"], path: Path, name: str) -> None:
    """Raise `FormatError` (`radians`) for rotation vectors of more than eight turns."""
    largest = np.abs(vectors).reshape(len(vectors), -1).max(axis=1)
    if largest.max() > MAX_RADIANS:
        frame = int(np.argmax(largest > MAX_RADIANS))
        message = f"{name}: {largest[frame]:.4g} where a rotation vector in radians was expected; are these degrees?"
        raise FormatError(message, path=path, reason="radians", frame=frame)


def framerate_of(
    archive: npy.Archive, keys: Sequence[str], options: ReadOptions, advice: str
) -> tuple[Fraction, str, list[str]]:
    """The framerate in use, the stated one as the file has it, and the log's lines.

    The first of `keys` that the archive has states it. Without a given framerate, raises `FormatError` with `advice`:
    `no-framerate` if none is stated, `framerate` for an invalid one.
    """
    key = next((key for key in keys if key in archive), None)
    value = None if key is None else archive.scalar(key)

    def stated() -> Fraction:
        try:
            if value is None:
                raise ValueError("no number")
            return parse_fps(value)
        except ValueError as error:
            message = f"{key or ' and '.join(keys)}: {value}, no usable framerate ({error}); {advice}"
            reason = "no-framerate" if key is None else "framerate"
            raise FormatError(message, path=archive.path, reason=reason) from None

    fps, operations = source_file.fps_in_use(options.fps, stated)
    return fps, "" if value is None else str(value), operations


def _skeleton(
    archive: npy.Archive, layout: PoseLayout, family: PoseLayout, options: ReadOptions
) -> tuple[Skeleton, list[str]]:
    if options.body_models is None:
        return posed_skeleton(None, layout, family, "", np.zeros(0))
    # Older releases print bytes into a string: "b'male'".
    gender = archive.text("gender").strip().lower().removeprefix("b'").removesuffix("'")
    betas = archive.numbers("betas", None) if "betas" in archive else np.zeros(0, np.float32)
    if betas.ndim not in (1, 2) or (betas.ndim == 2 and (betas != betas[0]).any()):
        message = f"betas of shape {betas.shape} that change, expected one body"
        raise FormatError(message, path=archive.path, reason="channel-count")
    betas = np.atleast_2d(betas)[0]
    if options.index is not None and options.index.published:
        # As HumanML3D's code: the female model for every gender but male, and ten betas (raw_pose_processing.ipynb).
        gender, betas = "male" if gender == "male" else "female", betas[:PUBLISHED_BETAS]
    return posed_skeleton(options.body_models, layout, family, gender if gender in GENDERS else "", betas)


def write_amass(motion: Motion, path: Path) -> None:
    """Write a motion as SMPL-X's 165 numbers per pose, z up, at its own framerate, for readers of AMASS.

    Rotations of SMPL's, SMPL-H's and SMPL-X's joints are written unchanged, with fingers and face. Any other skeleton
    is retargeted to SMPL's mean shape (`retarget`), with identity rotations of hands and face. Betas are always zeros:
    a `Motion` has bones, not a shape. Framerate and poses have both generations' names. Raises `SkeletonMapError`.
    """
    body = motion if rests_as_smpl(motion) else retarget(motion, mean_shape_skeleton())
    assert body.local_rotations is not None and body.root_translation is not None
    skeleton = body.skeleton
    rotations = np.zeros((body.num_frames, SMPLX.num_joints, 4), np.float32)
    rotations[..., 0] = 1.0
    for joint, name in enumerate(SMPLX.joint_names):
        if name in skeleton.joint_names:
            rotations[:, joint] = body.local_rotations[:, skeleton.index(name)]
    rotations[:, 0] = kinematics.quaternion_multiply(
        kinematics.quaternion_conjugate(body_frame.turn_of("z")), rotations[:, 0]
    )
    poses = kinematics.quaternion_to_rotation_vector(rotations).reshape(body.num_frames, -1).astype(np.float32)
    pelvis = skeleton.offsets[0] if skeleton.offsets[0].any() else mean_shape_skeleton().offsets[0]
    stops = np.cumsum([size for _, size in POSE_PARTS])
    slices = {key: poses[:, stop - size : stop] for (key, size), stop in zip(POSE_PARTS, stops, strict=True)}
    gender = skeleton.name.rpartition("-")[2]
    with path.open("wb") as file:
        np.savez(
            file,
            allow_pickle=False,
            poses=poses,
            **slices,
            trans=body_frame.from_y_up(body.root_translation.astype(np.float64), "z") - pelvis,
            betas=np.zeros(WRITTEN_BETAS, np.float32),
            num_betas=np.array(WRITTEN_BETAS),
            gender=np.array(gender if gender in GENDERS else "neutral"),
            surface_model_type=np.array(SMPLX.family),
            mocap_time_length=np.array(motion.duration_seconds),
            **dict.fromkeys(FRAMERATE_KEYS, np.array(float(motion.fps))),
        )
