"""LIIF in one dimension: a local MLP around each frame, two of them mixed at every instant."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from eval.baselines.peers.config import LiifNetworkConfig
from eval.baselines.peers.edsr import EdsrEncoder, unfolded
from eval.baselines.peers.mlp import mlp
from eval.baselines.peers.neighbours import even_neighbours, gathered, per_query
from pahires.network import ObservedWindow


class Liif(nn.Module):
    """LIIF (Chen et al. 2021; yinboc/liif) over time: unfolded features, relative time, relative cell → MLP → pose.

    Relative time is 2·(t − t_i)/Δ and the cell 2·dt/Δ, as on LIIF's grid of [−1, 1]; the answers of both neighbours
    are mixed by the opposite distance. Nothing is done about cells smaller than in training.
    """

    def __init__(self, config: LiifNetworkConfig, numbers: int) -> None:
        super().__init__()
        features = config.encoder.features
        self.encoder = EdsrEncoder(numbers, features, config.encoder.blocks)
        self.decoder = mlp(3 * features + 2, (config.hidden,) * config.layers, numbers)

    def forward(self, window: ObservedWindow) -> Float[Tensor, "batch queries numbers"]:
        """Normalised pose vectors at the queries."""
        near = even_neighbours(window)
        codes = gathered(unfolded(self.encoder(window.frames)), near.rows)
        place = torch.stack((2 * near.relative, 2 * per_query(near.cell, near.rows)), dim=-1)
        answers = self.decoder(torch.cat((codes, place), dim=-1))
        return torch.sum(near.weights[..., None] * answers, dim=0)
