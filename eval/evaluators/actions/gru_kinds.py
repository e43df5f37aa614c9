"""Action2Motion's two recognisers: which joints they see, in which order, axes and unit, at which framerate.

What they were trained on is nowhere described in full. Checked with the repository's own generated samples
(checkpoints/vae/*/joints, whose bone lengths name the joints) and with takes of the CMU database; docs/evaluators.md
has the figures. Source: https://github.com/EricGuo5513/action-to-motion (dataProcessing/dataset.py,
utils/paramUtil.py, index.html).
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from jaxtyping import Float32

from motionkit.errors import MotionkitError
from motionkit.formats import humanact12
from motionkit.skeleton import SMPL22

NUM_SMPL_JOINTS = 24
HAND_PER_FOREARM = 0.34
"""How far SMPL's hand joint lies beyond the wrist, in forearms."""

CMU_UNIT_METRES = 20 * 0.0254 / 0.45
"""The network's length unit: 20 of the CMU database's."""

PELVIS, NECK, HEAD = (SMPL22.index(name) for name in ("pelvis", "neck", "head"))
COLLARS, SHOULDERS, ELBOWS, WRISTS, HIPS, KNEES, ANKLES, TOES = (
    tuple(SMPL22.index(f"{side}_{joint}") for side in ("left", "right"))
    for joint in ("collar", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot")
)
# motionkit/skeletons/cmu.toml: a collar is this share of the way from the base of the neck to the shoulder; radius and
# wrist bone make the forearm; a hand goes on beyond it.
COLLAR_SHARE, RADIUS_SHARE, HAND_SHARE = 0.33, 2 / 3, 0.145

Clips = Float32[np.ndarray, "clips frames _joints 3"]


@dataclass(frozen=True)
class GruKind:
    """One published recogniser: `joints` turns clips of SMPL's joints (metres, y up) into what its network saw.

    A motion is a clip of `clip_length` frames at `fps`, the root of its first frame at the origin.
    """

    name: str
    title: str
    fps: Fraction
    clip_length: int
    num_joints: int
    actions: tuple[str, ...]
    joints: Callable[[Clips], Clips]


def humanact12_joints(clips: Clips) -> Clips:
    """SMPL's 24 joints as HumanAct12's camera saw them: y down, z away from it, metres.

    22 joints get hands that go on along the forearm. Raises `MotionkitError` for other numbers of joints.
    """
    if clips.shape[2] == SMPL22.num_joints:
        elbows, wrists = clips[:, :, list(ELBOWS)], clips[:, :, list(WRISTS)]
        clips = np.concatenate((clips, wrists + np.float32(HAND_PER_FOREARM) * (wrists - elbows)), axis=2)
    if clips.shape[2] != NUM_SMPL_JOINTS:
        raise MotionkitError(
            f"HumanAct12's recogniser sees SMPL's {NUM_SMPL_JOINTS} joints, or {SMPL22.num_joints} without hands; "
            f"these motions have {clips.shape[2]}"
        )
    return clips * np.array([1, -1, -1], np.float32)


def cmu_joints(clips: Clips) -> Clips:
    """20 joints of the CMU skeleton from the 22-joint layout: root, base of the neck, head, its top, then limb by limb.

    A limb is shoulder, elbow, wrist, hand or hip, knee, ankle, toes; left before right. For CMU's own takes all but the
    hands (2 cm) and the top of the head are where their skeleton has them, since `motionkit/skeletons/cmu.toml` is
    undone. Raises `MotionkitError` for fewer joints.
    """
    if clips.shape[2] not in (SMPL22.num_joints, NUM_SMPL_JOINTS):
        raise MotionkitError(
            f"the CMU recogniser takes the {SMPL22.num_joints} joints of the standard layout; these motions have "
            f"{clips.shape[2]}"
        )
    collars, shoulders = clips[:, :, list(COLLARS)], clips[:, :, list(SHOULDERS)]
    base = ((collars - COLLAR_SHARE * shoulders) / (1 - COLLAR_SHARE)).mean(axis=2)
    head = clips[:, :, HEAD]
    found = [clips[:, :, PELVIS], base, head, 2 * head - clips[:, :, NECK]]
    for shoulder, elbow, wrist in zip(SHOULDERS, ELBOWS, WRISTS, strict=True):
        forearm = clips[:, :, wrist] - clips[:, :, elbow]
        found += [clips[:, :, shoulder], clips[:, :, elbow], clips[:, :, elbow] + RADIUS_SHARE * forearm]
        found.append(clips[:, :, wrist] + HAND_SHARE * forearm)
    found += [clips[:, :, joint] for leg in zip(HIPS, KNEES, ANKLES, TOES, strict=True) for joint in leg]
    return (np.stack(found, axis=2) / CMU_UNIT_METRES).astype(np.float32)


HUMANACT12 = GruKind(
    name="humanact12",
    title="Action2Motion's GRU for HumanAct12",
    fps=humanact12.FPS,
    clip_length=60,
    num_joints=24,
    actions=humanact12.ACTIONS,
    joints=humanact12_joints,
)
CMU_MOCAP = GruKind(
    name="cmu-mocap",
    title="Action2Motion's GRU for its part of the CMU database",
    fps=Fraction(12),
    clip_length=100,
    num_joints=20,
    actions=("walk", "wash", "run", "jump", "animal behavior", "dance", "step", "climb"),
    joints=cmu_joints,
)
