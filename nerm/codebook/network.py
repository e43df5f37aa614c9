"""The VQ-VAE whose codes enrich the coordinates: T2M-GPT's architecture (T2M-GPT, models/vqvae.py, models/resnet.py).

Encoder: Conv k3, then twice (Conv k4 stride 2, ResNet-1D with dilations 9, 3, 1), Conv k3: four-fold downsampling in
time. The decoder mirrors it with nearest upsampling. ReLU, no norm. Codes are moving averages of what they encode.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn

from motionkit.core.shapes import Float, Float32, Int64
from motionkit.training.run import RunFolder
from motionkit.training.tensors import CheckpointError, load_tensors
from nerm.settings import CodebookNetworkConfig

DOWNSAMPLINGS = 2
DILATION_GROWTH = 3


class ResidualConvolution(nn.Module):
    """x + Conv1(ReLU(Conv3(ReLU(x)))), the first convolution dilated."""

    def __init__(self, width: int, dilation: int) -> None:
        super().__init__()
        self.dilated = nn.Conv1d(width, width, 3, padding=dilation, dilation=dilation)
        self.pointwise = nn.Conv1d(width, width, 1)

    def forward(self, x: Float[torch.Tensor, "batch width frames"]) -> Float[torch.Tensor, "batch width frames"]:
        """One block."""
        updated: torch.Tensor = x + self.pointwise(torch.relu(self.dilated(torch.relu(x))))
        return updated


def residual_stack(width: int, depth: int) -> nn.Sequential:
    """`depth` residual convolutions, the widest dilation first: 9, 3, 1 for three."""
    return nn.Sequential(*(ResidualConvolution(width, DILATION_GROWTH**power) for power in reversed(range(depth))))


def build_encoder(config: CodebookNetworkConfig, num_features: int) -> nn.Sequential:
    """Pose vectors [batch, numbers, frames] → [batch, code, frames / 4]."""
    width, layers = config.width, [nn.Conv1d(num_features, config.width, 3, padding=1), nn.ReLU()]
    for _ in range(DOWNSAMPLINGS):
        layers += [nn.Conv1d(width, width, 4, stride=2, padding=1), residual_stack(width, config.residual_layers)]
    return nn.Sequential(*layers, nn.Conv1d(width, config.code_dimension, 3, padding=1))


def build_decoder(config: CodebookNetworkConfig, num_features: int) -> nn.Sequential:
    """[batch, code, frames / 4] → pose vectors [batch, numbers, frames]."""
    width, layers = config.width, [nn.Conv1d(config.code_dimension, config.width, 3, padding=1), nn.ReLU()]
    for _ in range(DOWNSAMPLINGS):
        layers += [
            residual_stack(width, config.residual_layers),
            nn.Upsample(scale_factor=2, mode="nearest"),
            nn.Conv1d(width, width, 3, padding=1),
        ]
    layers += [nn.Conv1d(width, width, 3, padding=1), nn.ReLU(), nn.Conv1d(width, num_features, 3, padding=1)]
    return nn.Sequential(*layers)


@dataclass(frozen=True, eq=False)
class Quantised:
    """Features with each vector replaced by its nearest code; `values` pass gradients straight to the features."""

    values: Float[torch.Tensor, "batch code frames"]
    which: Int64[torch.Tensor, "batch frames"]
    commitment: Float[torch.Tensor, ""]


class Quantiser(nn.Module):
    """N codes, updated by exponential moving averages of the features nearest to them (van den Oord et al. 2017, A.1).

    Codes are initialised with features of the first batch; a code whose averaged count falls below `reset_below` is
    reset to one of the current features (T2M-GPT, models/quantize_cnn.py).
    """

    codes: torch.Tensor
    sums: torch.Tensor
    counts: torch.Tensor
    started: torch.Tensor

    def __init__(self, config: CodebookNetworkConfig) -> None:
        super().__init__()
        self.decay, self.reset_below = config.ema_decay, config.reset_below
        self.register_buffer("codes", torch.zeros(config.num_codes, config.code_dimension))
        self.register_buffer("sums", torch.zeros(config.num_codes, config.code_dimension))
        self.register_buffer("counts", torch.ones(config.num_codes))
        self.register_buffer("started", torch.tensor(False))

    def nearest(self, vectors: Float[torch.Tensor, "vectors code"]) -> Int64[torch.Tensor, "vectors"]:
        """Index of the code closest to each vector."""
        distances = self.codes.square().sum(1) - 2.0 * vectors @ self.codes.T
        return distances.argmin(dim=1)

    def forward(self, features: Float[torch.Tensor, "batch code frames"]) -> Quantised:
        """Quantise features."""
        vectors = features.transpose(1, 2).reshape(-1, features.shape[1])
        which = self.nearest(vectors.detach())
        codes = self.codes[which].reshape(features.shape[0], features.shape[2], -1).transpose(1, 2)
        commitment = (features - codes).square().mean()
        return Quantised(features + (codes - features).detach(), which.reshape(len(features), -1), commitment)

    @torch.no_grad()
    def start(self, features: Float[torch.Tensor, "batch code frames"], generator: torch.Generator) -> None:
        """Initialise the codes with a batch's features, repeated with a little noise if they are too few."""
        if bool(self.started):
            return
        self.codes.copy_(self._random_features(features, generator))
        self.sums.copy_(self.codes)
        self.counts.fill_(1.0)
        self.started.fill_(True)

    @torch.no_grad()
    def update(
        self,
        features: Float[torch.Tensor, "batch code frames"],
        which: Int64[torch.Tensor, "batch frames"],
        generator: torch.Generator,
    ) -> None:
        """Move the codes towards the features assigned to them, and reset rarely used ones."""
        vectors = features.detach().transpose(1, 2).reshape(-1, features.shape[1])
        chosen = which.reshape(-1)
        counts = torch.bincount(chosen, minlength=len(self.codes)).to(self.counts.dtype)
        sums = torch.zeros_like(self.sums).index_add_(0, chosen, vectors)
        self.counts.lerp_(counts, 1.0 - self.decay)
        self.sums.lerp_(sums, 1.0 - self.decay)
        in_use = (self.counts >= self.reset_below)[:, None]
        replacements = self._random_features(features, generator)
        self.codes.copy_(torch.where(in_use, self.sums / self.counts[:, None].clamp(min=1e-9), replacements))

    def _random_features(
        self, features: Float[torch.Tensor, "batch code frames"], generator: torch.Generator
    ) -> Float[torch.Tensor, "codes code"]:
        vectors = features.detach().transpose(1, 2).reshape(-1, features.shape[1])
        num_codes, width = self.codes.shape
        repeats = -(-num_codes // len(vectors))
        order = torch.cat([torch.randperm(len(vectors), generator=generator) for _ in range(repeats)])[:num_codes]
        chosen = vectors[order.to(vectors.device)]
        if repeats > 1:
            noise = torch.randn(num_codes, width, generator=generator).to(vectors.device)
            chosen = chosen + 0.01 * width**-0.5 * noise
        return chosen


class CodebookNetwork(nn.Module):
    """Encoder, quantiser and decoder on standardised pose vectors [batch, frames, numbers]."""

    def __init__(self, config: CodebookNetworkConfig, num_features: int) -> None:
        super().__init__()
        self.encoder = build_encoder(config, num_features)
        self.quantiser = Quantiser(config)
        self.decoder = build_decoder(config, num_features)

    def encode(
        self, vectors: Float[torch.Tensor, "batch frames numbers"]
    ) -> Float[torch.Tensor, "batch code short_frames"]:
        """Features before quantisation; `frames` must be a multiple of 4."""
        features: torch.Tensor = self.encoder(vectors.transpose(1, 2))
        return features

    def decode(
        self, features: Float[torch.Tensor, "batch code short_frames"]
    ) -> Float[torch.Tensor, "batch frames numbers"]:
        """Pose vectors from (quantised) features."""
        vectors: torch.Tensor = self.decoder(features).transpose(1, 2)
        return vectors


STAGE_NAME = "codebook"
FORMAT = "nerm-codebook"
FORMAT_VERSION = 1


def load_codes(run: RunFolder | Path) -> Float32[torch.Tensor, "codes dimension"]:
    """A run's trained codebook {e_i}; raises `CheckpointError` or `RunError` without one."""
    folder = (run if isinstance(run, RunFolder) else RunFolder(run)).stage(STAGE_NAME)
    if not folder.model_path.is_file():
        folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    if (description.get("format"), description.get("version")) != (FORMAT, FORMAT_VERSION) or "codes" not in tensors:
        raise CheckpointError(
            f"{folder.model_path} is {description.get('format')!r} version {description.get('version')}, expected "
            f"{FORMAT!r} version {FORMAT_VERSION}: train it again (motionkit train --stage codebook --overwrite)"
        )
    return tensors["codes"]
