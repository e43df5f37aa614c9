"""The spatial-temporal graph convolutional network that recognises UESTC's actions.

Ten blocks of 64 × 4, 128 × 3 and 256 × 3 channels; a block mixes joints along the body's graph, then time with a kernel
of 9 frames (stride 2 in the fifth and eighth). Parameters have the published file's names, so that it loads as it is.
Sources: Yan et al. 2018; https://github.com/Mathux/ACTOR (src/recognition/models).
"""

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor, nn

CHANNELS = (64, 64, 64, 64, 128, 128, 128, 256, 256, 256)
STRIDED = (4, 7)
TEMPORAL_KERNEL = 9
NUM_PARTITIONS = 3


def spatial_graph(parents: tuple[int, ...]) -> Float32[np.ndarray, "partitions joints joints"]:
    """The body's graph in three parts: each joint itself, neighbours level with it or further from the root, nearer.

    [k, v, w] is what joint v gives to joint w, divided by the number of w's neighbours, itself included. Distances are
    known up to one bone, as in the source: all joints that are further away count as level with one another.
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
    """Mixes channels once for each part of the graph, then joints along it."""

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
    """Graph convolution, convolution over time, and what goes past both."""

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
