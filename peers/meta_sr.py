"""Meta-SR in one dimension: predicted weights for every position between frames."""

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from motionkit.core.shapes import Float, Int
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

# Positions closer than this, in frames, share their weights.
PLACES_A_FRAME = 10_000


@dataclass(frozen=True)
class MetaSrNetworkConfig:
    """Meta-SR: one hidden layer that predicts the weights."""

    encoder: EdsrConfig = field(default_factory=EdsrConfig)
    hidden: int = 256


class MetaSr(nn.Module):
    """Meta-SR (Hu et al. 2019, as re-implemented in yinboc/liif) over time: no ensemble, only the previous frame.

    (relative time from the previous frame, 1/s) → `hidden` → a matrix from unfolded features to the pose. Instants at
    the same relative time share one matrix, so a batch at one scale needs few of them.
    """

    def __init__(self, config: MetaSrNetworkConfig, numbers: int) -> None:
        super().__init__()
        features = config.encoder.features
        self.numbers = numbers
        self.encoder = EdsrEncoder(config.encoder, numbers)
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


SYSTEM = image_system(
    "meta-sr",
    "Meta-SR over time: predicted weights for every position between frames",
    MetaSr,
    nano=MetaSrNetworkConfig(SMALL_ENCODER, hidden=64),
    base=MetaSrNetworkConfig(),
    paper=MetaSrNetworkConfig(),
)
