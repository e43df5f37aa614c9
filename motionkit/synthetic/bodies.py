"""Bodies: 22-joint skeletons of people of different height and proportions."""

from dataclasses import dataclass

import numpy as np

from motionkit.core.skeleton import SMPL22, Skeleton

# Bones of a person 1.70 m tall in metres, standing upright, arms hanging, facing +Z, left at +X. Lengths of legs and
# arms are those of the HumanML3D skeleton within 2 %; collars, spine and feet have their natural directions.
BONES: dict[str, tuple[float, float, float]] = {
    "pelvis": (0.0, 0.0, 0.0),
    "hip": (0.085, -0.085, 0.0),
    "spine1": (0.0, 0.115, -0.015),
    "knee": (0.0, -0.390, 0.0),
    "spine2": (0.0, 0.135, 0.005),
    "ankle": (0.0, -0.415, 0.0),
    "spine3": (0.0, 0.058, 0.010),
    "foot": (0.020, -0.058, 0.135),
    "neck": (0.0, 0.212, -0.030),
    "collar": (0.075, 0.112, -0.015),
    "head": (0.0, 0.090, 0.045),
    "shoulder": (0.108, 0.025, -0.010),
    "elbow": (0.0, -0.260, 0.0),
    "wrist": (0.0, -0.250, 0.0),
}
TOE_HEIGHT = 0.022
REFERENCE_HEIGHT = 1.70
LIMBS = {"legs": ("knee", "ankle"), "arms": ("elbow", "wrist"), "trunk": ("spine1", "spine2", "spine3", "neck")}


@dataclass(frozen=True, eq=False)
class Body:
    """A person: a skeleton with the names of SMPL's 22 joints, and lengths in metres used by the actions.

    `leg_length` is thigh + shin; `ankle_height` the ankle's height over the floor when the foot is flat;
    `hip_drop` the hips' distance below the pelvis; `stance_half_width` half the distance between the standing feet.
    """

    name: str
    height: float
    skeleton: Skeleton
    leg_length: float
    ankle_height: float
    hip_drop: float
    stance_half_width: float


def make_body(
    name: str, height: float = REFERENCE_HEIGHT, legs: float = 1.0, arms: float = 1.0, trunk: float = 1.0
) -> Body:
    """A body with a height in metres; `legs`, `arms` and `trunk` scale those bones before the whole is scaled."""
    stretch = {
        bone: factor for limb, factor in (("legs", legs), ("arms", arms), ("trunk", trunk)) for bone in LIMBS[limb]
    }
    lengths = {bone: np.array(offset) * stretch.get(bone, 1.0) for bone, offset in BONES.items()}
    tall = lengths["knee"][1] + lengths["ankle"][1] + BONES["hip"][1]
    upright = sum(float(lengths[bone][1]) for bone in (*LIMBS["trunk"], "head"))
    natural = upright - float(tall) + 0.08 + 0.09
    scale = height / natural
    offsets = np.stack([_offset(joint, lengths) for joint in SMPL22.joint_names]) * scale
    skeleton = Skeleton(
        name=f"smpl22-{name}",
        joint_names=SMPL22.joint_names,
        parents=SMPL22.parents,
        offsets=offsets.astype(np.float32),
        left_right_pairs=SMPL22.left_right_pairs,
        feet=SMPL22.feet,
    )
    # Everything is computed with the float32 bones that the skeleton holds, so that planted feet are planted exactly.
    bone = skeleton.offsets.astype(np.float64)
    return Body(
        name=name,
        height=height,
        skeleton=skeleton,
        leg_length=float(-bone[4, 1] - bone[7, 1]),
        ankle_height=float(TOE_HEIGHT * scale - bone[10, 1]),
        hip_drop=float(-bone[1, 1]),
        stance_half_width=float(bone[1, 0]) * 1.05,
    )


def draw_body(rng: np.random.Generator, name: str) -> Body:
    """A random person between 1.52 and 1.95 m with random proportions."""
    height = float(np.clip(rng.normal(1.71, 0.10), 1.52, 1.95))
    legs, arms, trunk = (float(value) for value in np.clip(rng.normal(1.0, 0.03, 3), 0.93, 1.07))
    return make_body(name, height, legs, arms, trunk)


def _offset(joint: str, lengths: dict[str, np.ndarray]) -> np.ndarray:
    side, _, bone = joint.rpartition("_")
    mirror = np.array([-1.0 if side == "right" else 1.0, 1.0, 1.0])
    return np.asarray(lengths[bone] * mirror)
