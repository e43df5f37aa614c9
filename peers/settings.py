"""Sizes of the peers' networks; imports nothing heavy. The defaults are the published ones."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class EdsrConfig:
    """The shared encoder: EDSR-baseline's 16 residual blocks of 64 features (receptive field: 69 frames)."""

    blocks: int = 16
    features: int = 64


@dataclass(frozen=True)
class LiifNetworkConfig:
    """LIIF: a decoder of `layers` hidden layers."""

    encoder: EdsrConfig = field(default_factory=EdsrConfig)
    hidden: int = 256
    layers: int = 4


@dataclass(frozen=True)
class MetaSrNetworkConfig:
    """Meta-SR: one hidden layer that predicts the weights."""

    encoder: EdsrConfig = field(default_factory=EdsrConfig)
    hidden: int = 256


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


@dataclass(frozen=True)
class DeltaInterpNetworkConfig:
    """Δ-Interp: `blocks` of attention and residual layers, shared by given and missing frames.

    A position is a frame of `frames_per_second`; the tables of learned positions and lengths have `positions` rows.
    """

    width: int = 1024
    blocks: int = 6
    layers: int = 3
    heads: int = 8
    embedding: int = 32
    positions: int = 256
    dropout: float = 0.2
    frames_per_second: float = 30.0


@dataclass(frozen=True)
class TsFormerNetworkConfig:
    """TS-Former: two transformer encoders of the same size, context and detail."""

    width: int = 512
    layers: int = 6
    heads: int = 8
    head_width: int = 64
    inner: int = 512
    frames_per_second: float = 30.0
