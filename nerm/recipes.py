"""Every setting of NeRM, and its named recipes: `paper` (the paper's figures), `nano` (two cores), `demo` (a minute).

Ablations of the paper are values here, not forks of the code: Table 5 `field.time_encoding`, Table 6
`field.variational`, Table 7 `field.decoder`, Table 8 `field.latent_dimension` and `field.kl_weight`, Table 9
`field.coordinates`.
"""

from dataclasses import dataclass, field
from typing import Literal

TimeEncoding = Literal["none", "fourier", "codebook"]
LatentLayout = Literal["global", "local"]
Activation = Literal["relu", "silu", "gelu"]


@dataclass(frozen=True)
class CodebookConfig:
    """The VQ-VAE whose codes enrich the coordinates: T2M-GPT's (spec of Zhang et al. 2023a; appendix B.1)."""

    fps: int = 20
    window_frames: int = 64
    width: int = 512
    code_dimension: int = 512
    num_codes: int = 512
    residual_layers: int = 3
    ema_decay: float = 0.99
    reset_below: float = 1.0
    position_weight: float = 0.5
    commitment_weight: float = 0.02
    steps: int = 300_000
    batch: int = 256
    rate: float = 2e-4
    rate_drop_at: int = 200_000
    rate_drop: float = 0.05
    where: str = "split = 'train'"


@dataclass(frozen=True)
class FieldConfig:
    """The variational implicit representation (paper §3.1, B, D); lengths in seconds, rates in frames a second."""

    max_duration_seconds: float = 10.0
    min_duration_seconds: float = 0.5
    stride_seconds: float = 10.0
    mirrored: bool = False
    where: str = "split = 'train'"
    # Latents: N(μ, Σ) per window; `local` reads z as knots along time.
    latent_layout: LatentLayout = "global"
    latent_dimension: int = 256
    num_knots: int = 16
    knot_radius: float = 2.0
    knot_modes: int = 2
    variational: bool = True
    kl_weight: float = 1e-4
    initial_log_variance: float = -6.0
    initialisation: Literal["normal", "ridge"] = "normal"
    ridge: float = 1e-2
    # Coordinates.
    time_encoding: TimeEncoding = "codebook"
    coordinates: Literal["normalised", "frames"] = "normalised"
    num_frequencies: int = 64
    frequency_scale: float = 4.0
    framerate_scale: float = 0.2
    num_queries: int = 256
    query_width: int = 128
    attention_heads: int = 4
    attention_layers: int = 3
    # Decoder.
    decoder: Literal["mlp", "transformer"] = "mlp"
    hidden: int = 1024
    layers: int = 9
    activation: Activation = "relu"
    # Data scale.
    scaling: Literal["number", "group"] = "number"
    root_weight: float = 1.0
    # Training.
    steps: int = 20_000
    batch: int = 4096
    num_poses: int = 32
    contiguous: bool = True
    warmup_fps: int = 20
    warmup_fraction: float = 0.5
    lowest_fps: float | None = None
    rate: float = 1e-4
    latent_rate: float = 1e-4
    weight_decay: float = 0.01
    schedule: Literal["constant", "cosine"] = "constant"
    rate_warmup_fraction: float = 0.0
    precision: Literal["float32", "bfloat16"] = "float32"


@dataclass(frozen=True)
class NermConfig:
    """All stages of NeRM."""

    codebook: CodebookConfig = field(default_factory=CodebookConfig)
    field: FieldConfig = field(default_factory=FieldConfig)
