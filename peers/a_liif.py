"""A-LIIF in one dimension: LIIF with a mixture of MLPs at every instant."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize

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
class ALiifNetworkConfig:
    """A-LIIF: `basis` MLPs of `layers` hidden layers of `width`, and the expansion network that mixes them.

    Published width 16, for three colour channels; 64, the width of the features, for pose vectors of 135 numbers.
    """

    encoder: EdsrConfig = field(default_factory=EdsrConfig)
    width: int = 16
    layers: int = 4
    basis: int = 10
    expansion_hidden: int = 256
    expansion_layers: int = 4


class ALiif(nn.Module):
    """A-LIIF (Li et al. 2022; LeeHW-THU/A-LIIF) over time: an expansion network weights the basis MLPs.

    Its coefficients have unit L2 norm and mix weights and biases of all layers alike. Everything else is LIIF's.
    """

    def __init__(self, config: ALiifNetworkConfig, numbers: int) -> None:
        super().__init__()
        features = config.encoder.features
        inputs = 3 * features + 2
        self.encoder = EdsrEncoder(config.encoder, numbers)
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


SYSTEM = image_system(
    "a-liif",
    "A-LIIF over time: LIIF with a mixture of MLPs at every instant",
    ALiif,
    nano=ALiifNetworkConfig(SMALL_ENCODER, width=FAIR_WIDTH, basis=4, expansion_hidden=64),
    base=ALiifNetworkConfig(width=FAIR_WIDTH),
    paper=ALiifNetworkConfig(),
)
