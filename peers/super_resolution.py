"""LIIF, Meta-SR, A-LIIF and LMF, super-resolution of images, in one dimension: local networks around each frame.

All have EDSR's encoder, one feature vector per frame, and need evenly spaced frames, for convolutions only see indices.
They differ in what makes a pose of the features on both sides of an instant.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize

from motionkit.core.shapes import Float
from motionkit.training.config import Schedule
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import TemporalSettings, base_training, nano_training
from pahires.temporal.system import TemporalSystem
from peers.completing import INTERPOLATION, Neighbours, completing_system, gathered, neighbours, on_task

KERNEL = 3
# Every s-th frame, s not whole, gives gaps of ⌊s⌋ and ⌈s⌉; and times are rounded.
LARGEST_GAP_RATIO = 2.01
# Meta-SR: positions closer than this, in frames, share their weights.
PLACES_A_FRAME = 10_000
Features = Float[Tensor, "batch frames features"]
Answers = Float[Tensor, "batch queries numbers"]


@dataclass(frozen=True)
class EdsrConfig:
    """The shared encoder: EDSR-baseline's 16 residual blocks of 64 features (receptive field: 69 frames)."""

    blocks: int = 16
    features: int = 64


class EdsrEncoder(nn.Module):
    """One feature vector per frame: head, `blocks` residual blocks, tail, and a skip from the head (EDSR, Lim 2017).

    As in EDSR-baseline, without normalisation or residual scaling. Padding is by replication, since zeros are not a
    valid pose; EDSR pads images with zeros.
    """

    def __init__(self, config: EdsrConfig, numbers: int) -> None:
        super().__init__()
        features = config.features
        self.head = _convolution(numbers, features)
        self.blocks = nn.ModuleList(
            nn.Sequential(_convolution(features, features), nn.ReLU(), _convolution(features, features))
            for _ in range(config.blocks)
        )
        self.tail = _convolution(features, features)

    def forward(self, frames: Float[Tensor, "batch frames numbers"]) -> Features:
        """Features at the observed frames."""
        head = hidden = self.head(frames.transpose(1, 2))
        for block in self.blocks:
            hidden = hidden + block(hidden)
        features: Tensor = self.tail(hidden) + head
        return features.transpose(1, 2)


def _convolution(inputs: int, outputs: int) -> nn.Conv1d:
    return nn.Conv1d(inputs, outputs, KERNEL, padding=KERNEL // 2, padding_mode="replicate")


def mlp(inputs: int, hidden: Sequence[int], outputs: int) -> nn.Sequential:
    """Linear layers of these widths, ReLU after all but the last."""
    widths = (inputs, *hidden)
    layers = [layer for pair in pairwise(widths) for layer in (nn.Linear(*pair), nn.ReLU())]
    return nn.Sequential(*layers, nn.Linear(widths[-1], outputs))


def unfolded(features: Features) -> Float[Tensor, "batch frames three_features"]:
    """Each frame's features beside those of both neighbours (LIIF §3, feature unfolding), the ends replicated."""
    before = torch.cat((features[:, :1], features[:, :-1]), dim=1)
    after = torch.cat((features[:, 1:], features[:, -1:]), dim=1)
    return torch.cat((before, features, after), dim=-1)


def even_neighbours(window: ObservedWindow) -> Neighbours:
    """Both neighbours of each query in windows of evenly spaced frames; raises `ValueError` for others.

    Gaps may differ by a factor of two, as those of every 1.2-th frame do.
    """
    gaps = torch.diff(window.times_seconds, dim=1)
    uneven = gaps[gaps.amax(dim=1) > LARGEST_GAP_RATIO * gaps.amin(dim=1)] if gaps.numel() else gaps
    if uneven.numel():
        raise ValueError(
            f"this model needs evenly spaced frames, but the gaps between those given range from "
            f"{float(uneven[0].min()):.4f} to {float(uneven[0].max()):.4f} s: use frames of one framerate, or "
            f"a model that reads their times (pahires, delta-interp, ts-former)"
        )
    return neighbours(window)


def local_inputs(encoder: EdsrEncoder, window: ObservedWindow) -> tuple[Neighbours, Float[Tensor, "2 batch queries _"]]:
    """Both neighbours of each query; their unfolded features, twice the relative time and twice the cell.

    Relative time is 2·(t − t_i)/Δ and the cell 2·dt/Δ, as on LIIF's grid of [−1, 1].
    """
    near = even_neighbours(window)
    codes = gathered(unfolded(encoder(window.frames)), near.rows)
    return near, torch.cat((codes, 2 * near.places(near.cell)), dim=-1)


@dataclass(frozen=True)
class LiifNetworkConfig:
    """LIIF: a decoder of `layers` hidden layers."""

    encoder: EdsrConfig = EdsrConfig()
    hidden: int = 256
    layers: int = 4


class Liif(nn.Module):
    """LIIF (Chen et al. 2021; yinboc/liif) over time: unfolded features, relative time, relative cell → MLP → pose.

    The outputs of both neighbours are weighted by the opposite distance. Cells smaller than in training get no special
    treatment.
    """

    def __init__(self, config: LiifNetworkConfig, numbers: int) -> None:
        super().__init__()
        self.encoder = EdsrEncoder(config.encoder, numbers)
        self.decoder = mlp(3 * config.encoder.features + 2, (config.hidden,) * config.layers, numbers)

    def forward(self, window: ObservedWindow) -> Answers:
        """Normalised pose vectors at the queries."""
        near, inputs = local_inputs(self.encoder, window)
        return near.mixed(self.decoder(inputs))


@dataclass(frozen=True)
class MetaSrNetworkConfig:
    """Meta-SR: one hidden layer that predicts the weights."""

    encoder: EdsrConfig = EdsrConfig()
    hidden: int = 256


class MetaSr(nn.Module):
    """Meta-SR (Hu et al. 2019, as re-implemented in yinboc/liif) over time: no ensemble, only the previous frame.

    (relative time from the previous frame, 1/s) → `hidden` → a matrix from unfolded features to the pose. Instants at
    the same relative time share one matrix, so a batch at one scale needs few of them.
    """

    def __init__(self, config: MetaSrNetworkConfig, numbers: int) -> None:
        super().__init__()
        self.numbers = numbers
        self.encoder = EdsrEncoder(config.encoder, numbers)
        self.weights = mlp(2, (config.hidden,), 3 * config.encoder.features * numbers)

    def forward(self, window: ObservedWindow) -> Answers:
        """Normalised pose vectors at the queries."""
        near = even_neighbours(window)
        codes = gathered(unfolded(self.encoder(window.frames)), near.rows[0])
        places = torch.round(near.places(near.cell)[0].flatten(0, 1) * PLACES_A_FRAME)
        shared, which = torch.unique(places, dim=0, return_inverse=True)
        matrices = self.weights(shared / PLACES_A_FRAME).reshape(len(shared), -1, self.numbers)
        # Queries are grouped by their matrix, padded, and multiplied as a batch.
        order, flat = torch.argsort(which, stable=True), codes.flatten(0, 1)
        counts = torch.bincount(which, minlength=len(matrices))
        column = torch.arange(len(which), device=which.device) - (torch.cumsum(counts, 0) - counts)[which[order]]
        grouped = codes.new_zeros(len(matrices), int(counts.max()), flat.shape[1])
        grouped = grouped.index_put((which[order], column), flat[order])
        products = torch.bmm(grouped, matrices)[which[order], column]
        return torch.empty_like(products).index_copy(0, order, products).view(*codes.shape[:2], self.numbers)


@dataclass(frozen=True)
class ALiifNetworkConfig:
    """A-LIIF: `basis` MLPs of `layers` hidden layers of `width`, and the expansion network that mixes them."""

    encoder: EdsrConfig = EdsrConfig()
    width: int = 16
    layers: int = 4
    basis: int = 10
    expansion_hidden: int = 256
    expansion_layers: int = 4


class ALiif(nn.Module):
    """A-LIIF (Li et al. 2022; LeeHW-THU/A-LIIF) over time: LIIF whose decoder is a mixture of MLPs at every instant.

    The expansion network's coefficients have unit L2 norm (as in the authors' code; not in the paper) and mix weights
    and biases of all layers alike.
    """

    def __init__(self, config: ALiifNetworkConfig, numbers: int) -> None:
        super().__init__()
        inputs = 3 * config.encoder.features + 2
        self.encoder = EdsrEncoder(config.encoder, numbers)
        self.expansion = mlp(inputs, (config.expansion_hidden,) * config.expansion_layers, config.basis)
        self.decoder = MixedMlp((inputs, *(config.width,) * config.layers, numbers), config.basis)

    def forward(self, window: ObservedWindow) -> Answers:
        """Normalised pose vectors at the queries."""
        near, inputs = local_inputs(self.encoder, window)
        return near.mixed(self.decoder(inputs, normalize(self.expansion(inputs), dim=-1)))


class MixedMlp(nn.Module):
    """An MLP with the weights Σ_k c_k·W_k and the biases Σ_k c_k·b_k in every layer, c given with each input.

    Equivalently all W_k are applied and their outputs mixed, so no matrix is built per instant.
    """

    def __init__(self, widths: Sequence[int], basis: int) -> None:
        super().__init__()
        self.basis = basis
        self.layers = nn.ModuleList(nn.Linear(before, basis * after) for before, after in pairwise(widths))

    def forward(
        self, inputs: Float[Tensor, "*some inputs"], coefficients: Float[Tensor, "*some basis"]
    ) -> Float[Tensor, "*some outputs"]:
        """The mixed network's outputs."""
        hidden = inputs
        for number, layer in enumerate(self.layers):
            each = layer(torch.relu(hidden) if number else hidden).unflatten(-1, (self.basis, -1))
            hidden = torch.einsum("...ko,...k->...o", each, coefficients)
        return hidden


@dataclass(frozen=True)
class LmfNetworkConfig:
    """LMF: a render MLP of `layers` hidden layers of `width`, and a latent MLP with one of `latent_hidden`."""

    encoder: EdsrConfig = EdsrConfig()
    width: int = 16
    layers: int = 6
    latent_hidden: int = 208


class Lmf(nn.Module):
    """LMF on LIIF (He & Jin 2024; HeZongyao/LMF) over time.

    Per frame a latent MLP predicts scales and shifts of the render MLP's layers and its small latent; the render
    MLP takes latent, relative time and cell, with x ← x·(1 + scale) + shift before each ReLU; two neighbours are mixed
    as LIIF does. Beyond the largest scale of the training both MLPs get that scale's cell.
    """

    def __init__(self, config: LmfNetworkConfig, numbers: int) -> None:
        super().__init__()
        width = config.width
        self.config, self.encoder = config, EdsrEncoder(config.encoder, numbers)
        self.latent = mlp(3 * config.encoder.features + 1, (config.latent_hidden,), (2 * config.layers + 1) * width)
        self.layers = nn.ModuleList(nn.Linear(width if layer else width + 2, width) for layer in range(config.layers))
        self.output = nn.Linear(width, numbers)

    def forward(self, window: ObservedWindow) -> Answers:
        """Normalised pose vectors at the queries."""
        near, depth = even_neighbours(window), self.config.layers
        # LMF's rule for larger scales: the cell 1/s times max(s/largest, 1), no smaller than in training.
        cell = near.cell * (1 / (near.cell * INTERPOLATION.largest_factor)).clamp(min=1)
        codes = unfolded(self.encoder(window.frames))
        at_frames = 2 * cell[:, None, None].expand(*codes.shape[:2], 1)
        modulations = gathered(self.latent(torch.cat((codes, at_frames), dim=-1)), near.rows)
        chunks = modulations.chunk(2 * depth + 1, dim=-1)
        hidden = torch.cat((chunks[-1], 2 * near.places(cell)), dim=-1)
        for layer, scale, shift in zip(self.layers, chunks[:depth], chunks[depth:-1], strict=True):
            hidden = torch.relu(layer(hidden) * (1 + scale) + shift)
        return near.mixed(self.output(hidden))


# Adam at 1e-4, halved every 200 of 1,000 epochs, batches of 16 windows of 48 frames.
PAPER = TemporalSettings(
    tasks=replace(INTERPOLATION, num_frames=48, num_queries=48),
    schedule=Schedule(epochs=1000, batch_size=16, learning_rate=1e-4, kind="steps", warmup_fraction=0.02),
)


def _system(name: str, network: type[nn.Module], nano: object, base: object, paper: object) -> TemporalSystem:
    recipes = {
        # At 1e-3 LMF's scales, multiplied through six layers, diverge: the plain form fails within 500 steps.
        "nano": (nano, on_task(INTERPOLATION, nano_training(), 4e-4 if network is Lmf else None)),
        "base": (base, on_task(INTERPOLATION, base_training())),
        "paper": (paper, PAPER),
    }
    return completing_system(name, network, recipes)


SMALL = EdsrConfig(blocks=4)
LIIF = _system("liif", Liif, LiifNetworkConfig(SMALL, hidden=128), LiifNetworkConfig(), LiifNetworkConfig())
META_SR = _system("meta-sr", MetaSr, MetaSrNetworkConfig(SMALL, 64), MetaSrNetworkConfig(), MetaSrNetworkConfig())
# For images of three colours a width of 16 is published; for pose vectors of 135 numbers that of the features is fair.
A_LIIF_SMALL = ALiifNetworkConfig(SMALL, width=64, basis=4, expansion_hidden=64)
A_LIIF = _system("a-liif", ALiif, A_LIIF_SMALL, ALiifNetworkConfig(width=64), ALiifNetworkConfig())
LMF = _system("lmf", Lmf, LmfNetworkConfig(SMALL, width=64), LmfNetworkConfig(width=64), LmfNetworkConfig())
