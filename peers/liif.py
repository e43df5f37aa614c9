"""LIIF and Meta-SR in one dimension: local networks around each frame, evaluated at any instant."""

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Int
from pahires.temporal.network import ObservedWindow
from peers.layers import EdsrEncoder, even_neighbours, gathered, mlp, per_query, unfolded
from peers.settings import LiifNetworkConfig, MetaSrNetworkConfig


class Liif(nn.Module):
    """LIIF (Chen et al. 2021; yinboc/liif) over time: unfolded features, relative time, relative cell → MLP → pose.

    Relative time is 2·(t − t_i)/Δ and the cell 2·dt/Δ, as on LIIF's grid of [−1, 1]; the outputs of both neighbours
    are weighted by the opposite distance. Cells smaller than in training get no special treatment.
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
        outputs = self.decoder(torch.cat((codes, place), dim=-1))
        return torch.sum(near.weights[..., None] * outputs, dim=0)


# Positions closer than this, in frames, share their weights.
PLACES_A_FRAME = 10_000


class MetaSr(nn.Module):
    """Meta-SR (Hu et al. 2019, as re-implemented in yinboc/liif) over time: no ensemble, only the previous frame.

    (relative time from the previous frame, 1/s) → `hidden` → a matrix from unfolded features to the pose. Instants at
    the same relative time share one matrix, so a batch at one scale needs few of them.
    """

    def __init__(self, config: MetaSrNetworkConfig, numbers: int) -> None:
        super().__init__()
        features = config.encoder.features
        self.numbers = numbers
        self.encoder = EdsrEncoder(numbers, features, config.encoder.blocks)
        self.weights = mlp(2, (config.hidden,), 3 * features * numbers)

    def forward(self, window: ObservedWindow) -> Float[Tensor, "batch queries numbers"]:
        """Normalised pose vectors at the queries."""
        near = even_neighbours(window)
        codes = gathered(unfolded(self.encoder(window.frames)), near.rows[0])
        places = torch.stack((near.relative[0], per_query(near.cell, near.rows[0])), dim=-1).flatten(0, 1)
        shared, which = torch.unique(torch.round(places * PLACES_A_FRAME), dim=0, return_inverse=True)
        matrices = self.weights(shared / PLACES_A_FRAME).reshape(len(shared), -1, self.numbers)
        return _each_by_its_matrix(codes.flatten(0, 1), matrices, which).reshape(*codes.shape[:2], self.numbers)


def _each_by_its_matrix(
    codes: Float[Tensor, "queries features"],
    matrices: Float[Tensor, "places features numbers"],
    which: Int[Tensor, "queries"],
) -> Float[Tensor, "queries numbers"]:
    """codes[q] @ matrices[which[q]]: queries are grouped by matrix, padded, and multiplied as a batch."""
    order = torch.argsort(which, stable=True)
    counts = torch.bincount(which, minlength=len(matrices))
    starts = torch.cumsum(counts, 0) - counts
    column = torch.arange(len(which), device=which.device) - starts[which[order]]
    laid_out = codes.new_zeros(len(matrices), int(counts.max()), codes.shape[1])
    laid_out = laid_out.index_put((which[order], column), codes[order])
    products = torch.bmm(laid_out, matrices)[which[order], column]
    return torch.empty_like(products).index_copy(0, order, products)
