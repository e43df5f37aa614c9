"""LMF in one dimension: a large MLP at the frames modulates a small one at the instants asked for."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from eval.baselines.peers.config import LmfNetworkConfig
from eval.baselines.peers.edsr import EdsrEncoder, unfolded
from eval.baselines.peers.mlp import mlp
from eval.baselines.peers.neighbours import even_neighbours, gathered, per_query
from pahires.network import ObservedWindow


class Lmf(nn.Module):
    """LMF on LIIF (He & Jin 2024; HeZongyao/LMF) over time.

    A latent MLP emits for each frame the scales and shifts of the render MLP's layers and its small latent; the render
    MLP takes latent, relative time and cell, with x ← x·(1 + scale) + shift before each ReLU; two neighbours are mixed
    as LIIF does. Beyond the largest scale of the training both MLPs are given that scale's cell.
    """

    def __init__(self, config: LmfNetworkConfig, numbers: int) -> None:
        super().__init__()
        features, self.width, self.depth = config.encoder.features, config.width, config.layers
        self.largest_scale = config.largest_scale
        modulations = (2 * self.depth + 1) * self.width
        self.encoder = EdsrEncoder(numbers, features, config.encoder.blocks)
        self.latent = mlp(3 * features + 1, (config.latent_hidden,), modulations)
        self.layers = nn.ModuleList(
            nn.Linear(self.width + 2 if layer == 0 else self.width, self.width) for layer in range(self.depth)
        )
        self.output = nn.Linear(self.width, numbers)

    def forward(self, window: ObservedWindow) -> Float[Tensor, "batch queries numbers"]:
        """Normalised pose vectors at the queries."""
        near = even_neighbours(window)
        cell = 2 * trained_cell(near.cell, self.largest_scale)
        codes = unfolded(self.encoder(window.frames))
        at_frames = cell[:, None, None].expand(*codes.shape[:2], 1)
        modulations = gathered(self.latent(torch.cat((codes, at_frames), dim=-1)), near.rows)
        parts = modulations.chunk(2 * self.depth + 1, dim=-1)
        scales, shifts, latent = parts[: self.depth], parts[self.depth : -1], parts[-1]
        place = torch.stack((2 * near.relative, per_query(cell, near.rows)), dim=-1)
        hidden = torch.cat((latent, place), dim=-1)
        for layer, scale, shift in zip(self.layers, scales, shifts, strict=True):
            hidden = torch.relu(layer(hidden) * (1 + scale) + shift)
        return torch.sum(near.weights[..., None] * self.output(hidden), dim=0)


def trained_cell(cell: Float[Tensor, "batch"], largest_scale: float) -> Float[Tensor, "batch"]:
    """The cell 1/s times max(s/largest, 1): no smaller than in training (LMF's rule for larger scales)."""
    return cell * (1 / (cell * largest_scale)).clamp(min=1)
