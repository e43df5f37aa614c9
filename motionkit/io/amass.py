"""AMASS motions (.npz): SMPL, SMPL-H and SMPL-X poses as axis–angle vectors, z up, with the subject's shape.

Systems that write this form may have y up (HY-Motion): the motion tells (`formats.up`).

The pelvis is at trans + J₀, where J₀ is its rest position for the subject's betas, and the centre of the root rotation.
Sources: https://github.com/nghorbani/amass (arrays, notebooks) and the file listings of its issues 8, 49 and 68 (names
of the two generations of files); Loper et al., "SMPL: A Skinned Multi-Person Linear Model", 2015, Eq. 2–4 and 10
(joints).
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
from motionkit.io.registry import FileHead, Format, ReadOptions, SourceItem
from motionkit.io.retargeting import retarget
from motionkit.io.smpl_body import (
    BODY,
    LAYOUTS,
    POSE_PARTS,
    SMPLH,
    SMPLX,
    Body,
    PoseLayout,
    mean_body,
    mean_shape_skeleton,
    own_body,
    rests_as_smpl,
)
from motionkit.io.source import clock, source_file

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
    poses, layout = _read_poses(archive)
    trans = archive.numbers("trans", (len(poses), 3))
    fps, stated_fps, operations = _framerate(archive, options)
    body = _body(archive, layout, options)
    rotations = kinematics.rotation_vector_to_quaternion(
        poses[:, : 3 * body.skeleton.num_joints].reshape(len(poses), -1, 3)
    )
    root = trans + body.skeleton.offsets[0]
    frames = up.sampled_frames(len(poses))
    sample = kinematics.forward_kinematics(rotations[frames], root[frames], body.skeleton)
    axis = options.up or up.infer_up(SMPL22, sample[:, : SMPL22.num_joints], ("z", "y"))
    rotations[:, 0] = kinematics.quaternion_multiply(up.turn_of(axis), rotations[:, 0])
    root = up.to_y_up(root, axis)
    operations += [*body.operations, *up.log_lines(axis, options.up)]
    return Motion(
        joint_positions=kinematics.forward_kinematics(rotations, root, body.skeleton),
        skeleton=body.skeleton,
        timegrid=TimeGrid(fps, len(root)),
        local_rotations=rotations,
        root_translation=root,
        sequence_id=item.sequence_id,
        provenance=source_file.provenance(
            path,
            data,
            "amass",
            operations,
            subject="" if path.parent == item.root else path.parent.name,
            stated_fps=stated_fps,
        ),
    )


def _body(archive: npy.Archive, layout: PoseLayout, options: ReadOptions) -> Body:
    if options.body_models is None:
        return mean_body(layout)
    gender, betas = _gender(archive), _betas(archive)
    if options.index is not None and options.index.published:
        # As HumanML3D's code: the female model for every gender but male, and ten betas (raw_pose_processing.ipynb).
        gender, betas = "male" if gender == "male" else "female", betas[:PUBLISHED_BETAS]
    return own_body(options.body_models, layout, LAYOUTS.get(_family(archive), SMPLH), gender, betas)


def _gender(archive: npy.Archive) -> str:
    # Older releases print bytes into a string: "b'male'".
    gender = _text(archive, "gender").removeprefix("b'").removesuffix("'")
    return gender if gender in GENDERS else ""


def _betas(archive: npy.Archive) -> Float32[np.ndarray, "betas"]:
    if "betas" not in archive:
        return np.zeros(0, np.float32)
    betas = archive.numbers("betas", None)
    if betas.ndim not in (1, 2) or (betas.ndim == 2 and (betas != betas[0]).any()):
        message = f"betas of shape {betas.shape} that change, expected one body"
        raise FormatError(message, path=archive.path, reason="channel-count")
    first: np.ndarray = np.atleast_2d(betas)[0]
    return first


def _read_poses(archive: npy.Archive) -> tuple[Float32[np.ndarray, "frames values"], PoseLayout]:
    if "poses" in archive:
        poses = archive.numbers("poses", (None, None))
    else:
        first = archive.numbers("root_orient", (None, 3))
        parts = [(key, size) for key, size in POSE_PARTS[1:] if key in archive or key == "pose_body"]
        others = [archive.numbers(key, (len(first), size)) for key, size in parts]
        poses = np.concatenate((first, *others), axis=1)
    turned = np.abs(poses).max(axis=1)
    if turned.max() > MAX_RADIANS:
        frame = int(np.argmax(turned > MAX_RADIANS))
        raise FormatError(
            f"poses: {turned[frame]:.4g} where a rotation vector in radians was expected; are these degrees?",
            path=archive.path,
            reason="radians",
            frame=frame,
        )
    return poses, _layout(archive, poses.shape[1])


def _layout(archive: npy.Archive, width: int) -> PoseLayout:
    stated = _family(archive)
    for layout in (*LAYOUTS.values(), BODY):
        if width == 3 * layout.num_joints and (layout is BODY or stated in ("", layout.family)):
            return layout
    widths = ", ".join(f"{3 * layout.num_joints} ({family})" for family, layout in LAYOUTS.items())
    raise FormatError(
        f"poses of {width} numbers{f' for the body model {stated[:20]!r}' if stated else ''}, expected {widths} or "
        f"{3 * BODY.num_joints} (body only)",
        path=archive.path,
        reason="channel-count",
    )


def _framerate(archive: npy.Archive, options: ReadOptions) -> tuple[Fraction, str, list[str]]:
    key = next((key for key in FRAMERATE_KEYS if key in archive), None)
    value = None if key is None else archive.scalar(key)
    stated = "" if value is None else str(value)
    fps, operations = clock.fps_in_use(options.fps, lambda: _stated_fps(value, key, archive.path))
    return fps, stated, operations


def _stated_fps(value: str | int | float | None, key: str | None, path: Path) -> Fraction:
    try:
        if value is None:
            raise ValueError("no number")
        return parse_fps(value)
    except ValueError as error:
        raise FormatError(
            f"{key or ' and '.join(FRAMERATE_KEYS)}: {'nothing' if value is None else value}, no usable framerate "
            f"({error}); give it in a rule (--fps-rules) or with --fps",
            path=path,
            reason="no-framerate" if key is None else "framerate",
        ) from None


def _family(archive: npy.Archive) -> str:
    # The file's body model, without a variant's suffix ("smplx_locked_head").
    return _text(archive, "surface_model_type").split("_")[0]


def _text(archive: npy.Archive, key: str) -> str:
    value = archive.scalar(key) if key in archive else None
    return value.strip().lower() if isinstance(value, str) else ""


def write_amass(motion: Motion, path: Path) -> None:
    """Write a motion as SMPL-X's 165 numbers per pose, z up, at its own framerate, for readers of AMASS.

    Rotations of SMPL's, SMPL-H's and SMPL-X's joints are written unchanged, with fingers and face. Any other skeleton
    is retargeted to SMPL's mean shape (`retarget`), with identity rotations of hands and face. Betas are always zeros:
    a `Motion` has bones, not a shape. Framerate and poses have both generations' names. Raises `SkeletonMapError`.
    """
    made = motion if rests_as_smpl(motion) else retarget(motion, mean_shape_skeleton())
    assert made.local_rotations is not None and made.root_translation is not None
    rotations = np.zeros((made.num_frames, SMPLX.num_joints, 4), np.float32)
    rotations[..., 0] = 1.0
    for joint, name in enumerate(SMPLX.joint_names):
        if name in made.skeleton.joint_names:
            rotations[:, joint] = made.local_rotations[:, made.skeleton.index(name)]
    rotations[:, 0] = kinematics.quaternion_multiply(kinematics.quaternion_conjugate(up.turn_of("z")), rotations[:, 0])
    poses = kinematics.quaternion_to_rotation_vector(rotations).reshape(made.num_frames, -1).astype(np.float32)
    resting = made.skeleton.offsets[0] if made.skeleton.offsets[0].any() else mean_shape_skeleton().offsets[0]
    stops = np.cumsum([size for _, size in POSE_PARTS])
    parts = {key: poses[:, stop - size : stop] for (key, size), stop in zip(POSE_PARTS, stops, strict=True)}
    gender = made.skeleton.name.rpartition("-")[2]
    with path.open("wb") as file:
        np.savez(
            file,
            allow_pickle=False,
            poses=poses,
            **parts,
            trans=up.from_y_up(made.root_translation.astype(np.float64), "z") - resting,
            betas=np.zeros(WRITTEN_BETAS, np.float32),
            num_betas=np.array(WRITTEN_BETAS),
            gender=np.array(gender if gender in GENDERS else "neutral"),
            surface_model_type=np.array(SMPLX.family),
            mocap_time_length=np.array(motion.duration_seconds),
            **dict.fromkeys(FRAMERATE_KEYS, np.array(float(motion.fps))),
        )


FORMAT = Format(
    name="amass",
    read=read_amass,
    write=write_amass,
    suffixes=(".npz",),
    accepts=accepts,
    beside=("shape.npz", "*_stagei.npz"),
    turns_up=True,
)
