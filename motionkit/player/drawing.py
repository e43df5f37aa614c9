"""What of a skeleton is drawn, and how: its bones, which are left and right, its head, hands and feet, its front."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from motionkit.skeleton import SMPL22, Skeleton
from motionkit.skeleton_transfer import counterpart_joints
from motionkit.skeletons.mapping import SkeletonMapError

# A joint whose distance from its parent changes by so much hangs on no bone: from the root (hips above a reference on
# the floor), and from any other joint, where a generated limb's length may well change by a decimetre.
TRAVELLING_FROM_ROOT_METRES, TRAVELLING_METRES = 0.1, 0.5
# Of feet without toes the ankles.
ENDS = (("left_foot", "left_ankle"), ("right_foot", "right_ankle"), ("left_wrist",), ("right_wrist",))
# Where no table knows a skeleton, the ends of its limbs are traced, of a few.
MOST_ENDS = 8
_SIDES = {"left": -1, "right": 1}


@dataclass(frozen=True)
class Drawing:
    """Of each joint the one that a bone joins it to (-1: none) and its side (-1 left, 0, 1 right).

    `head` is the joint of the head, -1 where none is known. `ends` are feet and hands. `yaw` is where the body faces in
    its first frame: the angle about Y, in radians, from Z+ towards X+.
    """

    bones: tuple[int, ...]
    sides: tuple[int, ...]
    head: int
    ends: tuple[int, ...]
    yaw: float


def drawing_of(skeleton: Skeleton, positions: Float32[np.ndarray, "frames joints 3"]) -> Drawing:
    """How a skeleton with these positions in metres is drawn; markers without bones are points."""
    try:
        own = {SMPL22.joint_names[joint]: source for joint, source in counterpart_joints(skeleton).items()}
    except SkeletonMapError:
        own = {}
    bones = _bones(skeleton, positions)
    sides = _sides(skeleton, own)
    ends = [next(own[name] for name in names if name in own) for names in ENDS if own.keys() & set(names)]
    ends = ends or _leaves(bones)[:MOST_ENDS]
    return Drawing(bones, sides, own.get("head", -1), tuple(dict.fromkeys(ends)), _yaw(own, positions))


def _bones(skeleton: Skeleton, positions: Float32[np.ndarray, "frames joints 3"]) -> tuple[int, ...]:
    parents = list(skeleton.parents)
    lengths = np.linalg.norm(positions - positions[:, [max(parent, 0) for parent in parents]], axis=-1)
    limits = [TRAVELLING_FROM_ROOT_METRES if parent == 0 else TRAVELLING_METRES for parent in parents]
    travels = np.ptp(lengths, axis=0) > limits
    bones = [-1 if far else parent for parent, far in zip(parents, travels.tolist(), strict=True)]
    # Markers have the first of them for their parent, and no rest pose.
    loose = not skeleton.offsets.any() and skeleton.num_joints > 1 and all(parent <= 0 for parent in parents)
    return tuple([-1] * len(bones) if loose else bones)


def _sides(skeleton: Skeleton, own: dict[str, int]) -> tuple[int, ...]:
    """The side of joints that are paired or have a counterpart on a side; what hangs on them is on it too."""
    sides = [0] * skeleton.num_joints
    for left, right in skeleton.left_right_pairs:
        sides[left], sides[right] = -1, 1
    for name, joint in own.items():
        sides[joint] = sides[joint] or _SIDES.get(name.partition("_")[0], 0)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            sides[joint] = sides[joint] or sides[parent]
    return tuple(sides)


def _leaves(bones: tuple[int, ...]) -> list[int]:
    return [joint for joint, parent in enumerate(bones) if parent >= 0 and joint not in bones]


def _yaw(own: dict[str, int], positions: Float32[np.ndarray, "frames joints 3"]) -> float:
    if "left_hip" not in own or "right_hip" not in own:
        return 0.0
    across = positions[0, own["left_hip"]] - positions[0, own["right_hip"]]
    # Left is at X+ of a body that faces Z+.
    return float(np.arctan2(-across[2], across[0]))
