"""LMF in one dimension: each frame modulates a small MLP."""

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float
from pahires.temporal.network import ObservedWindow
from peers.completing import (
    FAIR_WIDTH,
    SMALL_ENCODER,
    EdsrConfig,
    EdsrEncoder,
    even_neighbours,
    gathered,
    image_system,
    mlp,
    per_query,
    unfolded,
)


@dataclass(frozen=True)
class LmfNetworkConfig:
    """LMF: a render MLP of `layers` hidden layers of `width`; `largest_scale` is the training's.

    Published width 16, for three colour channels; 64, the width of the features, for pose vectors of 135 numbers. The
    latent MLP has one hidden layer of `latent_hidden` and (2·layers + 1)·width outputs, 208 as published.
    """

    encoder: EdsrConfig = field(default_factory=EdsrConfig)
    width: int = 16
    layers: int = 6
    latent_hidden: int = 208
    largest_scale: float = 4.0


class Lmf(nn.Module):
    """LMF on LIIF (He & Jin 2024; HeZongyao/LMF) over time.

    Per frame a latent MLP predicts scales and shifts of the render MLP's layers and its small latent; the render
    MLP takes latent, relative time and cell, with x ← x·(1 + scale) + shift before each ReLU; two neighbours are mixed
    as LIIF does. Beyond the largest scale of the training both MLPs get that scale's cell.
    """

    def __init__(self, config: LmfNetworkConfig, numbers: int) -> None:
        super().__init__()
        features, self.width, self.depth = config.encoder.features, config.width, config.layers
        self.largest_scale = config.largest_scale
        modulations = (2 * self.depth + 1) * self.width
        self.encoder = EdsrEncoder(config.encoder, numbers)
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


SYSTEM = image_system(
    "lmf",
    "LMF over time: frames modulate a small MLP",
    Lmf,
    nano=LmfNetworkConfig(SMALL_ENCODER, width=FAIR_WIDTH),
    base=LmfNetworkConfig(width=FAIR_WIDTH),
    paper=LmfNetworkConfig(),
    # At 1e-3 the scales, multiplied through six layers, diverge: the plain form fails within 500 steps.
    nano_learning_rate=4e-4,
)
