"""SMPL's bodies: the joint layouts of AMASS's pose arrays, body models, and the mean body used without one.

Names are those of the `smplx` package's joint lists without its suffix for eyes; the order of SMPL-X's pose array is
root, body, jaw, eyes, hands. Source: https://github.com/nghorbani/amass and https://github.com/vchoutas/smplx.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion, Provenance
from motionkit.core.shapes import Float, Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io import body_frame, npy, source_file

FINGERS = tuple(f"{finger}{bone}" for finger in ("index", "middle", "pinky", "ring", "thumb") for bone in (1, 2, 3))
HANDS = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in FINGERS)
FACE = ("jaw", "left_eye", "right_eye")


@dataclass(frozen=True)
class PoseLayout:
    """Joints of a body model, in the order of its pose array (3 numbers each).

    `family` names the body model (smpl, smplh, smplx) of the betas; the body joints alone have none.
    """

    family: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]

    @property
    def num_joints(self) -> int:
        """Number of joints J; a pose has 3·J numbers."""
        return len(self.joint_names)

    def skeleton(self, name: str, rest_joints: Float[np.ndarray, "joints 3"]) -> Skeleton:
        """The skeleton with these rest positions in metres."""
        offsets = rest_joints - rest_joints[np.maximum(self.parents, 0)]
        offsets[0] = rest_joints[0]
        names = self.joint_names
        lefts = [joint for joint in names if joint.startswith("left_")]
        return Skeleton(
            name=name,
            joint_names=names,
            parents=self.parents,
            offsets=offsets.astype(np.float32),
            left_right_pairs=tuple((names.index(left), names.index(f"right_{left[5:]}")) for left in lefts),
            feet=SMPL22.feet,
        )


def _layout(family: str, *extra: str) -> PoseLayout:
    names = (*SMPL22.joint_names, *extra)
    parents = list(SMPL22.parents)
    for name in extra:
        side, _, joint = name.partition("_")
        if name in FACE:
            above = "head"
        elif joint == "hand" or joint.endswith("1"):
            above = f"{side}_wrist"
        else:
            above = f"{name[:-1]}{int(name[-1]) - 1}"
        parents.append(names.index(above))
    return PoseLayout(family, names, tuple(parents))


BODY = _layout("")
SMPL = _layout("smpl", "left_hand", "right_hand")
SMPLH = _layout("smplh", *HANDS)
SMPLX = _layout("smplx", *FACE, *HANDS)
LAYOUTS: Mapping[str, PoseLayout] = {layout.family: layout for layout in (SMPL, SMPLH, SMPLX)}

# The separate arrays in which SMPL-H and SMPL-X files also give their poses, in the order of the pose array.
POSE_PARTS = (("root_orient", 3), ("pose_body", 63), ("pose_jaw", 3), ("pose_eye", 6), ("pose_hand", 90))


# SMPL-X files hold 300 shape directions and then 100 of facial expression; the small ones 10 and 10.
SMPLX_DIRECTIONS, SMPLX_BETAS, SMALL_SMPLX_BETAS = 400, 300, 10


@dataclass(frozen=True, eq=False)
class BodyModel:
    """A body model reduced to its joints: `mean_joints` at rest and their `shape_directions`, in metres."""

    family: str
    gender: str
    mean_joints: Float64[np.ndarray, "joints 3"]
    shape_directions: Float64[np.ndarray, "joints 3 betas"]

    def rest_joints(self, betas: Float[np.ndarray, "betas"]) -> Float64[np.ndarray, "joints 3"]:
        """Joints of the body with these betas at rest; betas beyond the model's are ignored."""
        used = min(len(betas), self.shape_directions.shape[-1])
        moved = self.shape_directions[..., :used] @ betas[:used].astype(np.float64)
        return np.asarray(self.mean_joints + moved)


def find_body_model(folder: Path, layout: PoseLayout, gender: str) -> BodyModel:
    """The model of a family for a gender, or the neutral one if the folder has no other.

    Files have the names as published for SMPL, MANO (SMPL-H) and SMPL-X, with or without the family's folder. Raises
    `FormatError` (`no-body-model`) if there is none, naming the accepted files.
    """
    family = layout.family
    candidates = [
        (each, parent / name)
        for each in dict.fromkeys((gender or "neutral", "neutral"))
        for parent in (folder / family, folder)
        for name in (f"{family.upper()}_{each.upper()}.npz", f"{each}/model.npz")
    ]
    for each, path in candidates:
        if path.is_file():
            return load_body_model(path, layout, each)
    for _, path in candidates:
        if path.with_suffix(".pkl").is_file():
            message = "is a pickle, which can run code; take the model's .npz, or convert it as docs/formats.md shows"
            raise FormatError(message, path=path.with_suffix(".pkl"), reason="no-body-model")
    names = ", ".join(path.relative_to(folder).as_posix() for _, path in candidates[:4])
    message = f"no {family} model for gender {gender or 'unknown'!r}, nor a neutral one; expected one of {names}"
    raise FormatError(message, path=folder, reason="no-body-model")


@lru_cache(maxsize=16)
def load_body_model(path: Path, layout: PoseLayout, gender: str) -> BodyModel:
    """Read a model file, once in each process; raises `FormatError` as `npy.Archive` does, and `bones`."""
    archive = npy.open_archive(path, source_file.read_bytes(path))
    template = archive.numbers("v_template", (None, 3)).astype(np.float64)
    regressor = archive.numbers("J_regressor", (None, len(template))).astype(np.float64)
    if len(regressor) != layout.num_joints:
        message = f"J_regressor has {len(regressor)} joints, expected the {layout.num_joints} of {layout.family}"
        raise FormatError(message, path=path, reason="bones")
    directions = archive.numbers("shapedirs", (len(template), 3, None))
    if layout.family == "smplx":
        directions = directions[..., : SMPLX_BETAS if directions.shape[-1] >= SMPLX_DIRECTIONS else SMALL_SMPLX_BETAS]
    moved = np.tensordot(regressor, directions.astype(np.float64), axes=1)
    return BodyModel(layout.family, gender, regressor @ template, moved)


def mean_shape_skeleton() -> Skeleton:
    """The 22 body joints of SMPL's mean shape as the skeleton `smpl22-mean-shape`."""
    rest = np.array(source_file.shipped("io/bodies.toml")["smpl"]["mean_offsets"], np.float64)
    for joint, parent in enumerate(BODY.parents):
        if parent >= 0:
            rest[joint] += rest[parent]
    return BODY.skeleton("smpl22-mean-shape", rest)


# Bones of the male and female bodies at rest are within this of the mean shape's.
_SAME_REST_COSINE = 0.8


def rests_as_smpl(motion: Motion) -> bool:
    """Whether a motion's rotations are those of SMPL's joints, relative to SMPL's rest pose."""
    skeleton = motion.skeleton
    if motion.local_rotations is None or motion.root_translation is None:
        return False
    if skeleton.joint_names[: BODY.num_joints] != BODY.joint_names:
        return False
    bones, usual = (each.offsets[1 : BODY.num_joints] for each in (skeleton, mean_shape_skeleton()))
    sizes = np.maximum(np.linalg.norm(bones, axis=-1) * np.linalg.norm(usual, axis=-1), 1e-9)
    return bool((np.sum(bones * usual, axis=-1) / sizes > _SAME_REST_COSINE).all())


def posed_skeleton(
    models: Path | None, layout: PoseLayout, family: PoseLayout, gender: str, betas: Float[np.ndarray, "betas"]
) -> tuple[Skeleton, list[str]]:
    """The joints at rest of a layout's poses, and the log lines that name their origin.

    `models` is the user's folder of body models. Without one they are the 22 joints of SMPL's mean shape, and the
    layout's other joints are dropped. `family` is the model of `BODY`, which has none. `gender` is empty if unknown.
    Raises `FormatError` (`no-body-model`).
    """
    if models is None:
        lines = ["joints: SMPL's mean shape, no body model given"]
        if left_out := layout.num_joints - BODY.num_joints:
            lines.append(f"rotations of {left_out} joints left out (hands, face): they need a body model")
        return mean_shape_skeleton(), lines
    model = find_body_model(models, family if layout is BODY else layout, gender)
    rest = model.rest_joints(betas)[: layout.num_joints]
    used = min(len(betas), model.shape_directions.shape[-1])
    fallback = "" if model.gender == gender else f" (the file's gender: {gender or 'unknown'})"
    line = f"joints: {model.family} {model.gender}{fallback}, {used} betas"
    return layout.skeleton(f"{model.family}-{model.gender}", rest), [line]


def posed_motion(
    rotations: Float32[np.ndarray, "frames joints 4"],
    translation: Float32[np.ndarray, "*frames 3"] | None,
    body: tuple[Skeleton, list[str]],
    fps: Fraction,
    up: str,
    source: Provenance,
    *,
    axes: Sequence[str] = ("y", "z", "-y"),
    turns_about_origin: bool = False,
) -> Motion:
    """The motion of a body (`posed_skeleton`) in metres, turned to y up; decisions are added to its log.

    `up` is the given axis; empty, it is inferred among `axes`. SMPL's body turns about its pelvis at rest, J₀, or about
    the origin, so that J₀ turns too. Without a translation the pelvis stays in place.
    """
    skeleton, lines = body
    if translation is None:
        lines = [*lines, "no translation in the file: the pelvis stays in place"]
        translation = np.zeros((len(rotations), 3), np.float32)
    local, pelvis = rotations[:, : skeleton.num_joints], skeleton.offsets[0]
    root = translation.reshape(-1, 3) + (
        kinematics.quaternion_rotate(local[:, 0], pelvis) if turns_about_origin else pelvis
    )
    positions = kinematics.forward_kinematics(local, root, skeleton)
    axis = up or body_frame.infer_up(SMPL22, positions[:, : SMPL22.num_joints], axes)
    operations = (*source.operations, *lines, *body_frame.log_lines(axis, up))
    source, name = replace(source, operations=operations), Path(source.source_path).stem
    motion = Motion(positions, skeleton, TimeGrid(fps, len(local)), local, root, sequence_id=name, provenance=source)
    return body_frame.turned(motion, axis)
