"""UESTC's recogniser as ACTOR published it: ST-GCN on SMPL's rotations, 60 frames at 30 fps, 40 actions.

It sees no positions: each joint's local rotation as the first two *rows* of its matrix, the root's in the camera's
frame (y down), with no translation. So it needs motions with true rotations (`SampleSet.local_rotations`); rotations
made from positions by inverse kinematics have lost the bones' twist and are another thing. Source:
https://github.com/Mathux/ACTOR (src/evaluate/stgcn_eval.py, src/datasets/uestc.py).
"""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32

from eval.evaluators.actions.clips import clip_rows
from eval.evaluators.actions.recogniser import Recognition, check_fps
from eval.evaluators.actions.stgcn_network import StgcnNetwork
from eval.evaluators.weights_digest import weights_digest
from eval.samples.sets import SampleSet
from motionkit import kinematics
from motionkit.errors import MotionkitError
from motionkit.formats.smpl import uestc
from motionkit.formats.smpl.layouts import SMPL
from motionkit.skeleton import SMPL22
from motionkit.training.foreign import fill_checked, read_foreign
from motionkit.training.tensors import CheckpointError

VERSION = "uestc-stgcn/1"
TITLE = "ACTOR's ST-GCN for UESTC"
CLIP_LENGTH = 60
NUM_CHANNELS = 6
MOTIONS_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class UestcRecogniser:
    """The published recogniser with its weights; implements `ActionRecogniser`."""

    network: StgcnNetwork
    fingerprint: str
    name: str = "uestc"
    fps: Fraction = uestc.FPS
    actions: tuple[str, ...] = uestc.ACTIONS

    def recognise(self, samples: SampleSet) -> Recognition:
        """Features [256] and scores of every sequence's clip of 60 frames (`action_clips.clip_frames`).

        Raises `MotionkitError` for another framerate, or without the local rotations of SMPL's 24 or 22 joints.
        """
        check_fps(self, samples)
        rotations = samples.local_rotations
        if rotations is None or rotations.shape[1] not in (SMPL.num_joints, SMPL22.num_joints):
            found = "positions only" if rotations is None else f"rotations of {rotations.shape[1]} joints"
            raise MotionkitError(
                f"{samples.name}: {found}, but UESTC's recogniser sees the local rotations of SMPL's "
                f"{SMPL.num_joints} joints (or {SMPL22.num_joints}, the hands then being straight)"
            )
        rows = clip_rows(samples, CLIP_LENGTH)
        features, scores = [], []
        with torch.inference_mode():
            for start in range(0, len(rows), MOTIONS_AT_ONCE):
                clips = rotation_rows(rotations[rows[start : start + MOTIONS_AT_ONCE]])
                some, each = self.network(torch.from_numpy(clips))
                features.append(some.double().numpy())
                scores.append(each.double().numpy())
        return Recognition(np.concatenate(features), np.concatenate(scores))


def rotation_rows(
    local_rotations: Float32[np.ndarray, "clips frames joints 4"],
) -> Float32[np.ndarray, "clips frames 24 6"]:
    """First two rows of every joint's matrix, the root turned back into the camera's frame; missing hands are straight.

    Source: ACTOR's rotation conversions, which are pytorch3d's.
    """
    missing = SMPL.num_joints - local_rotations.shape[2]
    straight = np.zeros((*local_rotations.shape[:2], missing, 4), np.float32)
    straight[..., 0] = 1.0
    whole = np.concatenate((local_rotations, straight), axis=2)
    # Half a turn about x, which undoes itself.
    whole[:, :, 0] = kinematics.quaternion_multiply(uestc.FROM_CAMERA, whole[:, :, 0])
    matrices = kinematics.quaternion_to_matrix(whole)
    return matrices[..., :2, :].reshape(*whole.shape[:3], NUM_CHANNELS).astype(np.float32)


def load_uestc(path: Path) -> UestcRecogniser:
    """Read ACTOR's `models/actionrecognition/uestc_rot6d_stgcn.tar` without running its pickle.

    Raises `CheckpointError` for a file that is no such checkpoint: names missing or too many, other shapes.
    """
    network = StgcnNetwork(SMPL.parents, NUM_CHANNELS, len(uestc.ACTIONS)).eval().requires_grad_(False)
    found = read_foreign(path)
    if not found or not all(isinstance(tensor, torch.Tensor) for tensor in found.values()):
        raise CheckpointError(
            f"{path}: not {TITLE}, whose file is a bare state dict (fcn.weight, data_bn.weight …); this one holds "
            f"{', '.join(found) or 'nothing'}"
        )
    fill_checked(network.state_dict(), found, "weights", path, TITLE)
    return UestcRecogniser(network, weights_digest(VERSION, network.state_dict()))
