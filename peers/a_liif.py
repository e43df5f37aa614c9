"""A-LIIF and LMF in one dimension: LIIF with an MLP that is a mixture of a few, or modulated."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize

from motionkit.core.shapes import Float
from pahires.temporal.network import ObservedWindow
from peers.layers import EdsrEncoder, even_neighbours, gathered, mlp, per_query, unfolded
from peers.settings import ALiifNetworkConfig, LmfNetworkConfig


class ALiif(nn.Module):
    """A-LIIF (Li et al. 2022; LeeHW-THU/A-LIIF) over time: an expansion network weights the basis MLPs.

    Its coefficients have unit L2 norm and mix weights and biases of all layers alike. Everything else is LIIF's.
    """

    def __init__(self, config: ALiifNetworkConfig, numbers: int) -> None:
        super().__init__()
        features = config.encoder.features
        inputs = 3 * features + 2
        self.encoder = EdsrEncoder(numbers, features, config.encoder.blocks)
        self.expansion = mlp(inputs, (config.expansion_hidden,) * config.expansion_layers, config.basis)
        self.decoder = MixedMlp(inputs, (config.width,) * config.layers, numbers, config.basis)

    def forward(self, window: ObservedWindow) -> Float[Tensor, "batch queries numbers"]:
        """Normalised pose vectors at the queries."""
        near = even_neighbours(window)
        codes = gathered(unfolded(self.encoder(window.frames)), near.rows)
        place = torch.stack((2 * near.relative, 2 * per_query(near.cell, near.rows)), dim=-1)
        inputs = torch.cat((codes, place), dim=-1)
        answers = self.decoder(inputs, self.coefficients(inputs))
        return torch.sum(near.weights[..., None] * answers, dim=0)

    def coefficients(self, inputs: Float[Tensor, "*some inputs"]) -> Float[Tensor, "*some basis"]:
        """Weights of the basis MLPs, of unit L2 norm (as in the authors' code; not in the paper)."""
        return normalize(self.expansion(inputs), dim=-1)


class MixedMlp(nn.Module):
    """An MLP with the weights Σ_k c_k·W_k and the biases Σ_k c_k·b_k in every layer, c given with each input.

    Equivalently all W_k are applied and their outputs mixed, so no matrix is built per instant.
    """

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int, basis: int) -> None:
        super().__init__()
        self.basis = basis
        widths = (inputs, *hidden, outputs)
        self.layers = nn.ModuleList(nn.Linear(before, basis * after) for before, after in pairwise(widths))

    def forward(
        self, inputs: Float[Tensor, "*some inputs"], coefficients: Float[Tensor, "*some basis"]
    ) -> Float[Tensor, "*some outputs"]:
        """The mixed network's outputs."""
        hidden = self._mixed(self.layers[0], inputs, coefficients)
        for layer in list(self.layers)[1:]:
            hidden = self._mixed(layer, torch.relu(hidden), coefficients)
        return hidden

    def _mixed(self, layer: nn.Module, inputs: Tensor, coefficients: Tensor) -> Tensor:
        each: Tensor = layer(inputs)
        return torch.einsum("...ko,...k->...o", each.reshape(*each.shape[:-1], self.basis, -1), coefficients)


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
