"""The joint layouts of AMASS's pose arrays: SMPL, SMPL-H, SMPL-X, and the body joints that all of them share.

Names are those of the `smplx` package's joint lists without its suffix for eyes; the order of SMPL-X's pose array is
root, body, jaw, eyes, hands. Source: https://github.com/nghorbani/amass and https://github.com/vchoutas/smplx.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from motionkit.skeleton import SMPL22, Skeleton

FINGERS = tuple(f"{finger}{bone}" for finger in ("index", "middle", "pinky", "ring", "thumb") for bone in (1, 2, 3))
HANDS = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in FINGERS)
FACE = ("jaw", "left_eye", "right_eye")


@dataclass(frozen=True)
class PoseLayout:
    """Joints of one body model, in the order of its pose array (3 numbers each).

    `family` names the body model (smpl, smplh, smplx) whose shape space the betas belong to; the body
    joints alone have none.
    """

    family: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]

    @property
    def num_joints(self) -> int:
        """Number of joints J; a pose has 3·J numbers."""
        return len(self.joint_names)

    def skeleton(self, name: str, rest_joints: Float[np.ndarray, "joints 3"]) -> Skeleton:
        """The skeleton whose joints rest at these places in metres."""
        above = np.array([max(parent, 0) for parent in self.parents])
        offsets = rest_joints - rest_joints[above]
        offsets[0] = rest_joints[0]
        return Skeleton(
            name=name,
            joint_names=self.joint_names,
            parents=self.parents,
            offsets=offsets.astype(np.float32),
            left_right_pairs=_pairs(self.joint_names),
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


def _pairs(names: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    lefts = [name for name in names if name.startswith("left_")]
    return tuple((names.index(name), names.index(name.replace("left_", "right_", 1))) for name in lefts)


BODY = _layout("")
SMPL = _layout("smpl", "left_hand", "right_hand")
SMPLH = _layout("smplh", *HANDS)
SMPLX = _layout("smplx", *FACE, *HANDS)
LAYOUTS: Mapping[str, PoseLayout] = {layout.family: layout for layout in (SMPL, SMPLH, SMPLX)}

# The parts in which SMPL-H and SMPL-X files also give their poses, in the order of the pose array.
POSE_PARTS = (("root_orient", 3), ("pose_body", 63), ("pose_jaw", 3), ("pose_eye", 6), ("pose_hand", 90))
