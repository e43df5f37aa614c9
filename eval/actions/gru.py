"""Action2Motion's GRU recognisers: HumanAct12's, which NeRM's Table 3 uses, and the one for the CMU database.

Two GRU layers of 128 over joint positions, Linear to 30 and tanh (the features of FID and Diversity), Linear to the
actions. The initial hidden state is zero; the published evaluation draws it from N(0, 1) for every batch, so that its
numbers differ between runs (docs/deviations.md). Source: https://github.com/EricGuo5513/action-to-motion
(models/motion_gan.py, eval_scripts/load_classifier.py).
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from eval.actions.recogniser import Recognition, check_fps, clip_rows
from eval.sets.sets import SampleSet
from eval.text_motion.guo.networks import weights_digest
from motionkit.core.errors import MotionkitError
from motionkit.core.shapes import Float, Float32
from motionkit.core.skeleton import SMPL22
from motionkit.io import joints_npy
from motionkit.training.loop import fill_checked, foreign_tensors, read_foreign

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
# motionkit/core/skeletons/cmu.toml: a collar is this share of the way from the base of the neck to the shoulder; radius
# and wrist bone make the forearm; a hand goes on beyond it.
COLLAR_SHARE, RADIUS_SHARE, HAND_SHARE = 0.33, 2 / 3, 0.145

Clips = Float32[np.ndarray, "clips frames _joints 3"]


@dataclass(frozen=True)
class GruKind:
    """A published recogniser: `joints` maps clips of SMPL's joints (metres, y up) to the network's input.

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
    """SMPL's 24 joints in HumanAct12's camera frame: y down, z away from it, metres.

    22 joints get hands that extend the forearm. Raises `MotionkitError` for other numbers of joints.
    """
    if clips.shape[2] == SMPL22.num_joints:
        elbows, wrists = clips[:, :, list(ELBOWS)], clips[:, :, list(WRISTS)]
        clips = np.concatenate((clips, wrists + np.float32(HAND_PER_FOREARM) * (wrists - elbows)), axis=2)
    if clips.shape[2] != NUM_SMPL_JOINTS:
        raise MotionkitError(
            f"HumanAct12's recogniser needs SMPL's {NUM_SMPL_JOINTS} joints, or {SMPL22.num_joints} without hands; "
            f"these motions have {clips.shape[2]}"
        )
    return clips * np.array([1, -1, -1], np.float32)


def cmu_joints(clips: Clips) -> Clips:
    """20 joints of the CMU skeleton from the 22-joint layout: root, base of the neck, head, its top, then limb by limb.

    A limb is shoulder, elbow, wrist, hand or hip, knee, ankle, toes; left before right. For CMU's own takes all but the
    hands (2 cm) and the top of the head are where their skeleton has them, since `motionkit/core/skeletons/cmu.toml` is
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
    fps=joints_npy.HUMANACT12_FPS,
    clip_length=60,
    num_joints=24,
    actions=joints_npy.HUMANACT12_ACTIONS,
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


VERSION = "gru-recogniser/1"
HIDDEN, NUM_FEATURES = 128, 30
KEY = "model"
MOTIONS_AT_ONCE = 256


class GruNetwork(nn.Module):
    """The network; parameters have the published file's names."""

    def __init__(self, num_inputs: int, num_actions: int) -> None:
        super().__init__()
        self.recurrent = nn.GRU(num_inputs, HIDDEN, num_layers=2, batch_first=True)
        self.linear1 = nn.Linear(HIDDEN, NUM_FEATURES)
        self.linear2 = nn.Linear(NUM_FEATURES, num_actions)

    def forward(
        self, poses: Float[Tensor, "clips frames numbers"]
    ) -> tuple[Float[Tensor, "clips features"], Float[Tensor, "clips actions"]]:
        """Features and logits after the last frame."""
        states, _ = self.recurrent(poses)
        features = torch.tanh(self.linear1(states[:, -1]))
        return features, self.linear2(features)


@dataclass(frozen=True, eq=False)
class GruRecogniser:
    """A published recogniser with its weights; implements `ActionRecogniser`."""

    kind: GruKind
    network: GruNetwork
    fingerprint: str

    @property
    def name(self) -> str:
        """Name for tables."""
        return self.kind.name

    @property
    def fps(self) -> Fraction:
        """The framerate of its training data."""
        return self.kind.fps

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of the actions, in the order of the scores."""
        return self.kind.actions

    def recognise(self, samples: SampleSet) -> Recognition:
        """Features [30] and scores of every sequence's clip (`action_clips.clip_frames`), its first root at the origin.

        Raises `MotionkitError` for another framerate or number of joints.
        """
        check_fps(self, samples)
        rows = clip_rows(samples, self.kind.clip_length)
        features, scores = [], []
        with torch.inference_mode():
            for start in range(0, len(rows), MOTIONS_AT_ONCE):
                clips = self.kind.joints(samples.sequences.values[rows[start : start + MOTIONS_AT_ONCE]])
                clips = clips - clips[:, :1, :1]
                found = self.network(torch.from_numpy(clips.reshape(*clips.shape[:2], -1)))
                features.append(found[0].double().numpy())
                scores.append(found[1].double().numpy())
        return Recognition(np.concatenate(features), np.concatenate(scores))


def load_gru(path: Path, kind: GruKind) -> GruRecogniser:
    """Read action-to-motion's `model_file/action_recognition_model_….tar` without running its pickle.

    Raises `CheckpointError` for any other file, or another recogniser's checkpoint.
    """
    tensors = foreign_tensors(read_foreign(path), KEY, path, kind.title)
    network = GruNetwork(3 * kind.num_joints, len(kind.actions)).eval().requires_grad_(False)
    fill_checked(dict(network.named_parameters()), tensors, KEY, path, kind.title)
    terms = f"{VERSION} {kind.name} {kind.fps} {kind.clip_length}"
    return GruRecogniser(kind, network, weights_digest(terms, network.state_dict()))
