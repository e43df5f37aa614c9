"""LIIF in one dimension: a local network around each frame, evaluated at any instant."""

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float
from pahires.temporal.network import ObservedWindow
from peers.completing import (
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
class LiifNetworkConfig:
    """LIIF: a decoder of `layers` hidden layers."""

    encoder: EdsrConfig = field(default_factory=EdsrConfig)
    hidden: int = 256
    layers: int = 4


class Liif(nn.Module):
    """LIIF (Chen et al. 2021; yinboc/liif) over time: unfolded features, relative time, relative cell → MLP → pose.

    Relative time is 2·(t − t_i)/Δ and the cell 2·dt/Δ, as on LIIF's grid of [−1, 1]; the outputs of both neighbours
    are weighted by the opposite distance. Cells smaller than in training get no special treatment.
    """

    def __init__(self, config: LiifNetworkConfig, numbers: int) -> None:
        super().__init__()
        features = config.encoder.features
        self.encoder = EdsrEncoder(config.encoder, numbers)
        self.decoder = mlp(3 * features + 2, (config.hidden,) * config.layers, numbers)

    def forward(self, window: ObservedWindow) -> Float[Tensor, "batch queries numbers"]:
        """Normalised pose vectors at the queries."""
        near = even_neighbours(window)
        codes = gathered(unfolded(self.encoder(window.frames)), near.rows)
        place = torch.stack((2 * near.relative, 2 * per_query(near.cell, near.rows)), dim=-1)
        outputs = self.decoder(torch.cat((codes, place), dim=-1))
        return torch.sum(near.weights[..., None] * outputs, dim=0)


SYSTEM = image_system(
    "liif",
    "LIIF over time: a local MLP around each frame (PA-HiRes' peer)",
    Liif,
    nano=LiifNetworkConfig(SMALL_ENCODER, hidden=128),
    base=LiifNetworkConfig(),
    paper=LiifNetworkConfig(),
)
