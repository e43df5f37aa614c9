"""Settings of NeRM's second stage: the diffusion process, the denoiser, its conditions and its training (no torch)."""

from dataclasses import dataclass, field
from typing import Literal, get_args

from motionkit.training.config import Precision

NoiseSchedule = Literal["scaled_linear", "cosine"]
Prediction = Literal["noise", "latent", "velocity"]
LossMeasure = Literal["noise", "latent", "velocity", "min_snr"]
Sampler = Literal["ddim", "ddpm"]
PathNumbers = Literal["places", "steps"]
LatentScale = Literal["number", "component"]
SAMPLERS: tuple[Sampler, ...] = get_args(Sampler)


@dataclass(frozen=True)
class DiffusionConfig:
    """The process, what the network predicts, and the sampler; the defaults are the paper's (Eq. 5, B.1).

    The paper's "scaled linearly" is linear in √β, as in latent diffusion models; "cosine" is Nichol & Dhariwal's
    (2021), which knows no `beta_start` and `beta_end`. `prediction` is what the network puts out: the noise ε (the
    paper), the clean latent z, or the velocity √ᾱ ε − √(1 − ᾱ) z (Salimans & Ho 2022); `loss` is the quantity whose
    squared error is learned, whichever is put out ("min_snr": that of z, weighed by min(SNR, 5); Hang et al. 2023).

    With `sampling_spacing` "trailing" the steps used at inference start at the noisiest one, the state that
    z_K ~ N(0, I) belongs to; "leading" (offset 1) starts up to num_steps / sampling_steps earlier, as
    motion-latent-diffusion does.
    """

    num_steps: int = 1000
    schedule: NoiseSchedule = "scaled_linear"
    beta_start: float = 8.5e-4
    beta_end: float = 0.012
    prediction: Prediction = "noise"
    loss: LossMeasure = "noise"
    sampler: Sampler = "ddim"
    sampling_steps: int = 50
    sampling_spacing: Literal["trailing", "leading"] = "trailing"

    def __post_init__(self) -> None:
        if not 0 < self.beta_start <= self.beta_end < 1:
            raise ValueError(f"betas must rise inside (0, 1), not from {self.beta_start} to {self.beta_end}")
        if not 1 <= self.sampling_steps <= self.num_steps:
            raise ValueError(f"sampling_steps must lie in 1 … {self.num_steps}, not {self.sampling_steps}")


@dataclass(frozen=True)
class TransformerConfig:
    """Sizes of the denoiser; the defaults are the `paper` recipe's.

    `latent_tokens` cuts z into that many tokens of equal size: 1 as in the paper, or more where the field reads z as
    knots in time: z goes by time, so each token is then a stretch of the motion.
    """

    num_layers: int = 9
    width: int = 256
    num_heads: int = 4
    ffn_width: int = 1024
    dropout: float = 0.1
    latent_tokens: int = 1

    def __post_init__(self) -> None:
        if self.num_layers % 2 == 0:
            raise ValueError(f"num_layers must be odd (n + 1 + n with skips), not {self.num_layers}")
        if self.width % (2 * self.num_heads):
            raise ValueError(f"width {self.width} must be a multiple of twice the {self.num_heads} heads")


@dataclass(frozen=True)
class DenoiserConfig:
    """The stage `denoiser`.

    `text_encoder` is what `motionkit.training.text_encoders.load_text_encoder` takes, or "none" to train without texts;
    `text_dimension` the size its embeddings must have (None: any). A share `condition_drop` of the batch is trained
    unconditionally; of the windows that have a caption and an action, `action_share` are trained on the action. Exactly
    one of `steps` and `epochs` says how long; `guidance_scale` is r of Eq. 6 at inference.

    Where the field reads z as knots, `path` says whether the diffusion sees the body's path as places or as the steps
    between them, and `latent_scale` whether each number of z is standardised by itself or each component by its values
    at all knots (`nerm.denoiser.latent_space`).
    """

    network: TransformerConfig = field(default_factory=TransformerConfig)
    diffusion: DiffusionConfig = field(default_factory=DiffusionConfig)
    path: PathNumbers = "places"
    latent_scale: LatentScale = "number"
    text_encoder: str = "minilm"
    text_dimension: int | None = None
    condition_drop: float = 0.1
    action_share: float = 0.25
    guidance_scale: float = 7.5
    batch: int = 64
    steps: int | None = None
    epochs: int | None = 3000
    rate: float = 1e-4
    weight_decay: float = 0.01
    schedule: Literal["constant", "cosine"] = "constant"
    rate_warmup_fraction: float = 0.0
    ema_decay: float = 0.9999
    precision: Precision = "float32"
    compile: bool = False

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.epochs is None):
            raise ValueError(f"exactly one of steps and epochs must be given, not {self.steps} and {self.epochs}")
        for name in ("steps", "epochs", "batch"):
            if (value := getattr(self, name)) is not None and value <= 0:
                raise ValueError(f"{name} must be positive, not {value}")
        for name in ("condition_drop", "action_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must lie in [0, 1], not {getattr(self, name)}")
        if not 0.0 <= self.ema_decay < 1.0:
            raise ValueError(f"ema_decay must lie in [0, 1), not {self.ema_decay}")

    def num_steps(self, num_windows: int) -> int:
        """Training steps on a corpus of `num_windows` latents."""
        if self.steps is not None:
            return self.steps
        assert self.epochs is not None
        return -(-self.epochs * num_windows // self.batch)
