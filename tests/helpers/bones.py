"""Lengths of bones, from joint positions, and those of people; rotations; what Mixamo calls the joints of SMPL."""

import numpy as np

import motionkit as mk
from motionkit.core.kinematics import forward_kinematics
from motionkit.core.skeletons.mapping import map_joints


def bone_lengths(positions: np.ndarray, skeleton: mk.Skeleton) -> np.ndarray:
    """Distance of every joint but the root to its parent [..., joints - 1], in metres."""
    return np.asarray(np.linalg.norm(positions[..., 1:, :] - positions[..., skeleton.parents[1:], :], axis=-1))


def check_rotations(motion: mk.Motion, tolerance: float = 1e-5) -> None:
    """A motion has rotations, whose forward kinematics gives its positions."""
    assert motion.local_rotations is not None and motion.root_translation is not None
    again = forward_kinematics(motion.local_rotations, motion.root_translation, motion.skeleton)
    np.testing.assert_allclose(again, motion.joint_positions, atol=tolerance)


def bone(body: np.ndarray, one: str, other: str) -> float:
    return float(np.linalg.norm(body[:, mk.SMPL22.index(one)] - body[:, mk.SMPL22.index(other)], axis=-1).mean())


# Lengths of bones of a person, metres.
BONES = {
    **{(f"{side}_{one}", f"{side}_{other}"): limits for side in ("left", "right") for one, other, limits in (
        ("hip", "knee", (0.34, 0.52)), ("knee", "ankle", (0.36, 0.50)), ("ankle", "foot", (0.08, 0.22)),
        ("shoulder", "elbow", (0.22, 0.35)), ("elbow", "wrist", (0.19, 0.32)),
    )},
    ("left_shoulder", "right_shoulder"): (0.15, 0.45),
    ("left_hip", "right_hip"): (0.10, 0.25),
}  # fmt: skip


def check_body(motion: mk.Motion) -> None:
    """A motion becomes a person's body whose toes point forwards."""
    body = map_joints(motion, "smpl22")
    for (one, other), (least, most) in BONES.items():
        assert least < bone(body, one, other) < most, (motion, one, other)
    leg = bone(body, "left_hip", "left_knee") + bone(body, "left_knee", "left_ankle")
    assert 1.15 < leg + bone(body, "pelvis", "head") < 1.7, motion
    # Forward is where the toes point; seen from there, +x of the body is its left.
    across = body[:, mk.SMPL22.index("left_hip")] - body[:, mk.SMPL22.index("right_hip")]
    up = body[:, mk.SMPL22.index("neck")] - body[:, mk.SMPL22.index("pelvis")]
    toes = body[:, mk.SMPL22.index("left_foot")] - body[:, mk.SMPL22.index("left_ankle")]
    assert np.median(np.sum(np.cross(across, up) * toes, axis=-1)) > 0, motion
    assert map_joints(motion, "kit21").shape[1] == 21


SPINE = {"pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head"}
LIMBS = {"hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase", "collar": "Shoulder", "shoulder": "Arm"}
LIMBS |= {"elbow": "ForeArm", "wrist": "Hand"}


def mixamo_name(joint: str) -> str:
    """Without the prefix that its files have."""
    side, _, limb = joint.rpartition("_")
    return SPINE[joint] if joint in SPINE else side.capitalize() + LIMBS[limb]
