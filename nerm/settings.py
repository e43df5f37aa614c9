"""Settings of the stages `codebook`, `field` and `denoiser` (no torch)."""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal, get_args

from motionkit.core.timegrid import parse_fps
from motionkit.training.config import Precision


@dataclass(frozen=True)
class CodebookConfig:
    """The VQ-VAE whose codes enrich the coordinates: T2M-GPT's (Zhang et al. 2023a; appendix B.1).

    `published_weights` names T2M-GPT's own checkpoint, which is then taken instead of trained, whatever the sizes here;
    `published_statistics` the folder of its mean.npy and std.npy (the evaluator's), which the field doesn't need.
    """

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
    weight_decay: float = 0.0
    precision: Precision = "float32"
    published_weights: str = ""
    published_statistics: str = ""
    where: str = "split = 'train'"

    def __post_init__(self) -> None:
        parse_fps(self.fps)
        for name in ("window_frames", "batch", "steps"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")


TimeEncoding = Literal["none", "raw", "fourier", "codebook"]
LatentLayout = Literal["global", "local"]
PoseVectorsName = Literal["field", "native", "rotations"]
Activation = Literal["relu", "silu", "gelu"]


@dataclass(frozen=True)
class FieldConfig:
    """The variational implicit representation (paper §3.1, B, D); lengths in seconds, rates in frames a second.

    `fixed_fps` is Table 1's "NeRM-fixed": every pose of the training is taken at that framerate (an integer, a decimal
    or a fraction such as 30000/1001), and slower sequences are left out.
    """

    max_duration_seconds: float = 10.0
    min_duration_seconds: float = 0.5
    stride_seconds: float = 10.0
    mirrored: bool = False
    where: str = "split = 'train'"
    # What is learnt at each instant (nerm/pose_vectors/): positions, the published 263 numbers, SMPL's rotations.
    pose_vectors: PoseVectorsName = "field"
    # Latents: N(μ, Σ) per window. `local` reads z as banks of knots along time (nerm/latents/local.py): bank i has
    # knots[i] knots of knot_numbers[i] pose components each; path_knots knots hold the body's path (0: no such bank).
    latent_layout: LatentLayout = "global"
    latent_dimension: int = 256
    knots: tuple[int, ...] = (16,)
    knot_numbers: tuple[int, ...] = (16,)
    path_knots: int = 0
    knot_kernel: Literal["hann", "lanczos"] = "hann"
    knot_radius: float = 2.0
    knot_modes: int = 2
    variational: bool = True
    kl_weight: float = 1e-4
    initial_log_variance: float = -6.0
    initialisation: Literal["normal", "ridge"] = "normal"
    ridge: float = 1e-2
    # Coordinates. `raw` is t itself (Table 5's "no time encoding"), `none` no coordinate at all.
    time_encoding: TimeEncoding = "codebook"
    coordinates: Literal["normalised", "frames"] = "normalised"
    num_frequencies: int = 64
    frequency_scale: float = 4.0
    framerate_scale: float = 0.2
    num_queries: int = 256
    attention_heads: int = 4
    attention_layers: int = 3
    # Decoder.
    decoder: Literal["mlp", "transformer"] = "mlp"
    hidden: int = 1024
    layers: int = 9
    activation: Activation = "relu"
    linear_path: bool = False
    # Data scale.
    scaling: Literal["number", "group"] = "number"
    root_weight: float = 1.0
    # Training.
    epochs: int | None = 20_000
    steps: int | None = None
    batch: int = 4096
    num_poses: int = 32
    contiguous: bool = True
    seconds_per_visit: float = 10.0
    warmup_fps: int = 20
    warmup_fraction: float = 0.5
    lowest_fps: float | None = None
    fixed_fps: str | None = None
    rate: float = 1e-4
    attention_rate: float = 1e-4
    latent_rate: float = 1e-4
    weight_decay: float = 0.01
    schedule: Literal["constant", "cosine"] = "constant"
    rate_warmup_fraction: float = 0.0
    precision: Precision = "float32"
    compile: bool = False

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.epochs is None):
            raise ValueError(f"exactly one of steps and epochs must be given, not {self.steps} and {self.epochs}")
        if self.latent_layout == "local" and self.coordinates == "frames":
            raise ValueError("knots lie at normalised coordinates: frame numbers (Table 9) need latent_layout=global")
        if self.latent_layout == "local":
            self._check_banks()
        elif self.linear_path or self.initialisation == "ridge":
            raise ValueError("linear_path and initialisation=ridge belong to a linear model of local latents")
        for name in ("steps", "epochs", "batch", "num_poses", "max_duration_seconds", "stride_seconds"):
            if (value := getattr(self, name)) is not None and not value > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        for fps in (self.warmup_fps, self.lowest_fps, self.fixed_fps):
            if fps is not None:
                parse_fps(fps)

    def _check_banks(self) -> None:
        if len(self.knots) != len(self.knot_numbers) or not self.knots:
            raise ValueError(f"knots and knot_numbers name one bank each: not {self.knots} and {self.knot_numbers}")
        banks = zip((*self.knots, self.path_knots), (*self.knot_numbers, 3), strict=True)
        total = sum(knots * numbers for knots, numbers in banks)
        if self.latent_dimension != total:
            raise ValueError(
                f"knots={self.knots} of knot_numbers={self.knot_numbers} and path_knots={self.path_knots} of 3 make "
                f"latent_dimension={total}, not {self.latent_dimension}"
            )
        if self.path_knots and self.pose_vectors != "field":
            raise ValueError(
                f"a path of the body is a path of positions: pose_vectors={self.pose_vectors} needs path_knots=0, and "
                f"latent_dimension={total - 3 * self.path_knots} then"
            )
        if self.path_knots and self.scaling != "group":
            raise ValueError("a path of the body turns poses, so x and z need one scale: scaling=group")

    @property
    def fixed_framerate(self) -> Fraction | None:
        """The one framerate of the whole training, exactly; None where it is continuous-framerate training."""
        return None if self.fixed_fps is None else parse_fps(self.fixed_fps)

    @property
    def query_width(self) -> int:
        """Width of CCA's queries: that of γ(t), which its output joins by addition (the paper's 128 for R = 64)."""
        return 2 * self.num_frequencies

    def num_steps(self, visits: int) -> int:
        """Training steps where an epoch has this many visits to windows."""
        if self.steps is not None:
            return self.steps
        assert self.epochs is not None
        return -(-self.epochs * visits // self.batch)


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
