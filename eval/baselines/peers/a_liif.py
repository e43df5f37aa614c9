"""A-LIIF in one dimension: LIIF whose MLP is mixed at every instant from a few basis MLPs."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from eval.baselines.peers.config import ALiifNetworkConfig
from eval.baselines.peers.edsr import EdsrEncoder, unfolded
from eval.baselines.peers.mlp import mlp
from eval.baselines.peers.neighbours import even_neighbours, gathered, per_query
from pahires.network import ObservedWindow


class ALiif(nn.Module):
    """A-LIIF (Li et al. 2022; LeeHW-THU/A-LIIF) over time: an expansion network says how basis MLPs are mixed.

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
        """How much of each basis MLP there is, of unit L2 norm (the authors' code; the paper says nothing of it)."""
        return normalize(self.expansion(inputs), dim=-1)


class MixedMlp(nn.Module):
    """An MLP with the weights Σ_k c_k·W_k and the biases Σ_k c_k·b_k in every layer, c given with each input.

    All W_k are applied and their results mixed, which is the same and makes no matrix for each instant.
    """

    def __init__(self, inputs: int, hidden: Sequence[int], outputs: int, basis: int) -> None:
        super().__init__()
        self.basis = basis
        widths = (inputs, *hidden, outputs)
        self.layers = nn.ModuleList(nn.Linear(before, basis * after) for before, after in pairwise(widths))

    def forward(
        self, inputs: Float[Tensor, "*some inputs"], coefficients: Float[Tensor, "*some basis"]
    ) -> Float[Tensor, "*some outputs"]:
        """The mixed network's answers."""
        hidden = self._mixed(self.layers[0], inputs, coefficients)
        for layer in list(self.layers)[1:]:
            hidden = self._mixed(layer, torch.relu(hidden), coefficients)
        return hidden

    def _mixed(self, layer: nn.Module, inputs: Tensor, coefficients: Tensor) -> Tensor:
        each: Tensor = layer(inputs)
        return torch.einsum("...ko,...k->...o", each.reshape(*each.shape[:-1], self.basis, -1), coefficients)
