"""The published recognisers: Action2Motion's GRU for HumanAct12 and ACTOR's ST-GCN for UESTC.

The GRU sees clips of joint positions: two layers of 128, Linear to 30 and tanh (the features of FID and Diversity),
Linear to the actions. The initial hidden state is zero; the published evaluation draws it from N(0, 1) for every batch,
so that its numbers differ between runs (docs/deviations.md). Source: https://github.com/EricGuo5513/action-to-motion
(models/motion_gan.py, eval_scripts/load_classifier.py).

The ST-GCN sees each joint's local rotation as the first two *rows* of its matrix, the root's in the camera's frame (y
down), without positions or translation. So it needs motions with true rotations (`SampleSet.local_rotations`);
rotations from inverse kinematics lack the bones' twist. Source: https://github.com/Mathux/ACTOR
(src/evaluate/stgcn_eval.py, src/datasets/uestc.py).
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from eval.actions.recogniser import ActionRecogniser, FeaturesAndScores, find_recogniser
from eval.sets.sets import SampleSet
from motionkit.core import kinematics
from motionkit.core.errors import MotionkitError
from motionkit.core.shapes import Float, Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.io import joints_npy, uestc
from motionkit.io.smpl_body import SMPL
from motionkit.training.loop import fill_checked, foreign_tensors, read_foreign, weights_digest

CLIP_FRAMES = 60
MOTIONS_AT_ONCE = 64
HAND_PER_FOREARM = 0.34
"""How far SMPL's hand joint lies beyond the wrist, in forearms."""

Rows = Int64[np.ndarray, "clips frames"]
Outputs = tuple[Float[Tensor, "clips features"], Float[Tensor, "clips actions"]]


def describe(
    network: nn.Module, inputs: Callable[[SampleSet, Rows], Float32[np.ndarray, "clips ..."]], samples: SampleSet
) -> FeaturesAndScores:
    """Features and scores of every sequence's clip of 60 frames; `inputs` are the network's, from rows of clips."""
    rows = clip_rows(samples)
    with torch.inference_mode():
        batches = (rows[start : start + MOTIONS_AT_ONCE] for start in range(0, len(rows), MOTIONS_AT_ONCE))
        outputs = [network(torch.from_numpy(inputs(samples, batch))) for batch in batches]
    features, scores = (torch.cat(each).double().numpy() for each in zip(*outputs, strict=True))
    return features, scores


def clip_rows(samples: SampleSet) -> Rows:
    """Rows of `samples` that make each sequence's clip: its middle, or all frames padded with the last one.

    The published evaluations use a random segment of a longer motion (action-to-motion, dataProcessing/dataset.py;
    ACTOR, src/datasets/dataset.py).
    """
    start, length = samples.sequences.start_row[:, None], samples.sequences.num_frames[:, None]
    frames = np.maximum(length - CLIP_FRAMES, 0) // 2 + np.arange(CLIP_FRAMES)
    return np.asarray(start + np.minimum(frames, length - 1), dtype=np.int64)


class GruNetwork(nn.Module):
    """Action2Motion's network; parameters have the published file's names."""

    def __init__(self, num_inputs: int, num_actions: int) -> None:
        super().__init__()
        self.recurrent = nn.GRU(num_inputs, 128, num_layers=2, batch_first=True)
        self.linear1 = nn.Linear(128, 30)
        self.linear2 = nn.Linear(30, num_actions)

    def forward(self, poses: Float[Tensor, "clips frames numbers"]) -> Outputs:
        """Features and logits after the last frame."""
        states, _ = self.recurrent(poses)
        features = torch.tanh(self.linear1(states[:, -1]))
        return features, self.linear2(features)


def humanact12_inputs(samples: SampleSet, rows: Rows) -> Float32[np.ndarray, "clips frames 72"]:
    """SMPL's 24 joints in HumanAct12's camera frame (y down, z away from it), metres, the first root at the origin.

    22 joints get hands that extend the forearm.
    """
    clips = samples.sequences.values[rows]
    if clips.shape[2] == SMPL22.num_joints:
        elbows, wrists = (
            [SMPL22.index(f"{side}_{joint}") for side in ("left", "right")] for joint in ("elbow", "wrist")
        )
        hands = clips[:, :, wrists] + np.float32(HAND_PER_FOREARM) * (clips[:, :, wrists] - clips[:, :, elbows])
        clips = np.concatenate((clips, hands), axis=2)
    clips = (clips - clips[:, :1, :1]) * np.array([1, -1, -1], np.float32)
    return np.asarray(clips.reshape(*clips.shape[:2], -1))


def load_humanact12(path: Path) -> ActionRecogniser:
    """Read action-to-motion's `model_file/action_recognition_model_humanact12.tar` without running its pickle.

    Raises `CheckpointError` for any other file, or another recogniser's checkpoint.
    """
    source, actions = find_recogniser("humanact12"), joints_npy.HUMANACT12_ACTIONS
    tensors = foreign_tensors(read_foreign(path), "model", path, source.title)
    network = GruNetwork(3 * SMPL.num_joints, len(actions)).eval().requires_grad_(False)
    fill_checked(dict(network.named_parameters()), tensors, "model", path, source.title)
    digest = weights_digest(f"gru-recogniser/1 {source.name} {source.fps} {CLIP_FRAMES}", network.state_dict())
    return ActionRecogniser(source.name, source.fps, actions, digest, partial(describe, network, humanact12_inputs))


CHANNELS = (64, 64, 64, 64, 128, 128, 128, 256, 256, 256)
STRIDED = (4, 7)
TEMPORAL_KERNEL = 9
NUM_PARTITIONS = 3


def spatial_graph(parents: tuple[int, ...]) -> Float32[np.ndarray, "partitions joints joints"]:
    """The body's graph, partitioned into each joint itself, neighbours not nearer to the root, and nearer ones.

    [k, v, w] is the weight from joint v to joint w, divided by the number of w's neighbours, itself included. As in the
    source, joints more than one bone from the root count as equally far.
    """
    itself = np.eye(len(parents), dtype=bool)
    linked = itself.copy()
    for child, parent in enumerate(parents[1:], start=1):
        linked[child, parent] = linked[parent, child] = True
    share = linked / linked.sum(axis=0)
    away = np.where(linked[0], 1, 2)
    away[0] = 0
    nearer = away[:, None] < away[None, :]
    partitions = (itself, ~itself & ~nearer, ~itself & nearer)
    return np.stack([np.where(partition, share, 0.0) for partition in partitions]).astype(np.float32)


class GraphConvolution(nn.Module):
    """Spatial graph convolution: mixes channels per partition, then joints along the graph."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs * NUM_PARTITIONS, kernel_size=1)

    def forward(
        self, x: Float[Tensor, "clips inputs frames joints"], graph: Float[Tensor, "partitions joints joints"]
    ) -> Float[Tensor, "clips outputs frames joints"]:
        """Sum over partitions and neighbours."""
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
    """ACTOR's network, to be used in evaluation mode."""

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

    def forward(self, poses: Float[Tensor, "clips frames joints channels"]) -> Outputs:
        """Features (the mean over frames and joints) and scores."""
        joints, channels = poses.shape[2:]
        normalised = self.data_bn(poses.flatten(2).transpose(1, 2))
        x = normalised.unflatten(1, (joints, channels)).permute(0, 2, 3, 1)
        for block, importance in zip(self.st_gcn_networks, self.edge_importance, strict=True):
            x = block(x, self.A * importance)
        features = x.mean(dim=(2, 3))
        return features, self.fcn(features[..., None, None]).flatten(1)


def uestc_inputs(samples: SampleSet, rows: Rows) -> Float32[np.ndarray, "clips frames 24 6"]:
    """First two rows of every joint's matrix, the root's in the camera's frame; missing hands are straight.

    Raises `MotionkitError` without the local rotations of SMPL's 24 or 22 joints. Source: ACTOR, rotation conversions.
    """
    rotations = samples.local_rotations
    if rotations is None or rotations.shape[1] not in (SMPL.num_joints, SMPL22.num_joints):
        given = "positions only" if rotations is None else f"rotations of {rotations.shape[1]} joints"
        raise MotionkitError(
            f"{samples.name}: {given}, but UESTC's recogniser sees the local rotations of SMPL's {SMPL.num_joints} "
            f"joints (or {SMPL22.num_joints}, the hands then being straight)"
        )
    clips = np.zeros((*rows.shape, SMPL.num_joints, 4), np.float32)
    clips[..., 0] = 1.0
    clips[:, :, : rotations.shape[1]] = rotations[rows]
    # Half a turn about x, which undoes itself.
    clips[:, :, 0] = kinematics.quaternion_multiply(uestc.FROM_CAMERA, clips[:, :, 0])
    matrices = kinematics.quaternion_to_matrix(clips)
    return matrices[..., :2, :].reshape(*clips.shape[:3], 6).astype(np.float32)


def load_uestc(path: Path) -> ActionRecogniser:
    """Read ACTOR's `models/actionrecognition/uestc_rot6d_stgcn.tar` without running its pickle.

    Raises `CheckpointError` for any other file: missing or unexpected names, other shapes.
    """
    source = find_recogniser("uestc")
    network = StgcnNetwork(SMPL.parents, 6, len(uestc.ACTIONS)).eval().requires_grad_(False)
    fill_checked(network.state_dict(), read_foreign(path), "weights", path, source.title)
    digest = weights_digest("uestc-stgcn/1", network.state_dict())
    return ActionRecogniser(source.name, source.fps, uestc.ACTIONS, digest, partial(describe, network, uestc_inputs))
