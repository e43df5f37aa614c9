"""Lengths of bones, from joint positions, and those of people."""

import numpy as np

from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import map_joints


def bone_lengths(positions: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Distance of every joint but the root to its parent [..., joints - 1], in metres."""
    return np.asarray(np.linalg.norm(positions[..., 1:, :] - positions[..., skeleton.parents[1:], :], axis=-1))


def bone(body: np.ndarray, one: str, other: str) -> float:
    return float(np.linalg.norm(body[:, SMPL22.index(one)] - body[:, SMPL22.index(other)], axis=-1).mean())


# Lengths of bones of a person, metres.
BONES = {
    **{(f"{side}_{one}", f"{side}_{other}"): limits for side in ("left", "right") for one, other, limits in (
        ("hip", "knee", (0.34, 0.52)), ("knee", "ankle", (0.36, 0.50)), ("ankle", "foot", (0.08, 0.22)),
        ("shoulder", "elbow", (0.22, 0.35)), ("elbow", "wrist", (0.19, 0.32)),
    )},
    ("left_shoulder", "right_shoulder"): (0.15, 0.45),
    ("left_hip", "right_hip"): (0.10, 0.25),
}  # fmt: skip


def check_body(motion: Motion) -> None:
    """A motion becomes a person's body whose toes point forwards."""
    body = map_joints(motion, "smpl22")
    for (one, other), (least, most) in BONES.items():
        assert least < bone(body, one, other) < most, (motion, one, other)
    leg = bone(body, "left_hip", "left_knee") + bone(body, "left_knee", "left_ankle")
    assert 1.15 < leg + bone(body, "pelvis", "head") < 1.7, motion
    # Forward is where the toes point; seen from there, +x of the body is its left.
    across = body[:, SMPL22.index("left_hip")] - body[:, SMPL22.index("right_hip")]
    up = body[:, SMPL22.index("neck")] - body[:, SMPL22.index("pelvis")]
    toes = body[:, SMPL22.index("left_foot")] - body[:, SMPL22.index("left_ankle")]
    assert np.median(np.sum(np.cross(across, up) * toes, axis=-1)) > 0, motion
    assert map_joints(motion, "kit21").shape[1] == 21
