"""UESTC's recogniser as ACTOR published it: ST-GCN on SMPL's rotations, 60 frames at 30 fps, 40 actions.

Its input is each joint's local rotation as the first two *rows* of its matrix, the root's in the camera's frame (y
down), without positions or translation. So it needs motions with true rotations (`SampleSet.local_rotations`);
rotations from inverse kinematics lack the bones' twist. Source:
https://github.com/Mathux/ACTOR (src/evaluate/stgcn_eval.py, src/datasets/uestc.py).
"""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from eval.actions.recogniser import Recognition, check_fps, clip_rows
from eval.sets.sets import SampleSet
from eval.text_motion.guo.networks import weights_digest
from motionkit.core import kinematics
from motionkit.core.errors import MotionkitError
from motionkit.core.shapes import Float, Float32
from motionkit.core.skeleton import SMPL22
from motionkit.io import uestc
from motionkit.io.smpl_body import SMPL
from motionkit.training.loop import CheckpointError, fill_checked, read_foreign

CHANNELS = (64, 64, 64, 64, 128, 128, 128, 256, 256, 256)
STRIDED = (4, 7)
TEMPORAL_KERNEL = 9
NUM_PARTITIONS = 3


def spatial_graph(parents: tuple[int, ...]) -> Float32[np.ndarray, "partitions joints joints"]:
    """The body's graph, partitioned into each joint itself, neighbours not nearer to the root, and nearer ones.

    [k, v, w] is the weight from joint v to joint w, divided by the number of w's neighbours, itself included. As in the
    source, distances are known up to one bone: joints further away count as equally far.
    """
    joints = len(parents)
    linked = np.eye(joints, dtype=bool)
    for child, parent in enumerate(parents):
        if parent >= 0:
            linked[child, parent] = linked[parent, child] = True
    share = linked / linked.sum(axis=0)
    away = np.where(linked[0], 1, 2)
    away[0] = 0
    nearer = away[:, None] < away[None, :]
    itself = np.eye(joints, dtype=bool)
    parts = (itself, ~itself & ~nearer, ~itself & nearer)
    return np.stack([np.where(part, share, 0.0) for part in parts]).astype(np.float32)


class GraphConvolution(nn.Module):
    """Spatial graph convolution: mixes channels per partition, then joints along the graph."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs * NUM_PARTITIONS, kernel_size=1)

    def forward(
        self, x: Float[Tensor, "clips inputs frames joints"], graph: Float[Tensor, "partitions joints joints"]
    ) -> Float[Tensor, "clips outputs frames joints"]:
        """Sum over parts and neighbours."""
        each = self.conv(x).unflatten(1, (NUM_PARTITIONS, -1))
        return torch.einsum("nkctv,kvw->nctw", each, graph)


class Block(nn.Module):
    """Graph convolution, temporal convolution, and a residual connection."""

    def __init__(self, inputs: int, outputs: int, stride: int, *, residual: bool) -> None:
        super().__init__()
        self.gcn = GraphConvolution(inputs, outputs)
        padding = (TEMPORAL_KERNEL - 1) // 2
        self.tcn = nn.Sequential(
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
            nn.Conv2d(outputs, outputs, (TEMPORAL_KERNEL, 1), (stride, 1), (padding, 0)),
            nn.BatchNorm2d(outputs),
        )
        self.residual: nn.Module | None = None
        if residual and (inputs, stride) == (outputs, 1):
            self.residual = nn.Identity()
        elif residual:
            self.residual = nn.Sequential(
                nn.Conv2d(inputs, outputs, kernel_size=1, stride=(stride, 1)), nn.BatchNorm2d(outputs)
            )

    def forward(
        self, x: Float[Tensor, "clips inputs frames joints"], graph: Float[Tensor, "partitions joints joints"]
    ) -> Float[Tensor, "clips outputs fewer_frames joints"]:
        """One block."""
        past = 0.0 if self.residual is None else self.residual(x)
        return torch.relu(self.tcn(self.gcn(x, graph)) + past)


class StgcnNetwork(nn.Module):
    """The whole network, to be used in evaluation mode."""

    A: Tensor

    def __init__(self, parents: tuple[int, ...], num_channels: int, num_actions: int) -> None:
        super().__init__()
        graph = torch.from_numpy(spatial_graph(parents))
        self.register_buffer("A", graph)
        self.data_bn = nn.BatchNorm1d(num_channels * len(parents))
        inputs = (num_channels, *CHANNELS[:-1])
        self.st_gcn_networks = nn.ModuleList(
            Block(before, after, 2 if place in STRIDED else 1, residual=place > 0)
            for place, (before, after) in enumerate(zip(inputs, CHANNELS, strict=True))
        )
        self.edge_importance = nn.ParameterList([nn.Parameter(torch.ones_like(graph)) for _ in CHANNELS])
        self.fcn = nn.Conv2d(CHANNELS[-1], num_actions, kernel_size=1)

    def forward(
        self, poses: Float[Tensor, "clips frames joints channels"]
    ) -> tuple[Float[Tensor, "clips features"], Float[Tensor, "clips actions"]]:
        """Features (the mean over frames and joints) and scores."""
        joints, channels = poses.shape[2:]
        normalised = self.data_bn(poses.flatten(2).transpose(1, 2))
        x = normalised.unflatten(1, (joints, channels)).permute(0, 2, 3, 1)
        for block, importance in zip(self.st_gcn_networks, self.edge_importance, strict=True):
            x = block(x, self.A * importance)
        features = x.mean(dim=(2, 3))
        return features, self.fcn(features[..., None, None]).flatten(1)


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

    Raises `CheckpointError` for any other file: missing or unexpected names, other shapes.
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
