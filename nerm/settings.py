"""Settings of the stages `codebook`, `field` and `denoiser`, nested as their parts are (no torch)."""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

from motionkit.core.timegrid import parse_fps
from motionkit.features.convention import PoseVectorsName
from motionkit.training.config import Precision, Schedule, require_positive
from motionkit.training.diffusion.settings import DiffusionConfig


@dataclass(frozen=True)
class CodebookNetworkConfig:
    """Sizes of the VQ-VAE; codes are moving averages of decay `ema_decay`, and one whose averaged count falls below
    `reset_below` is reset."""

    width: int = 512
    code_dimension: int = 512
    num_codes: int = 512
    residual_layers: int = 3
    ema_decay: float = 0.99
    reset_below: float = 1.0


@dataclass(frozen=True)
class CodebookLossConfig:
    """Weights of the joint position error and of the commitment loss, relative to the reconstruction error."""

    position_weight: float = 0.5
    commitment_weight: float = 0.02


@dataclass(frozen=True)
class CodebookScheduleConfig:
    """Steps, windows per step, and the learning rate, which is multiplied by `drop` at step `drop_at`."""

    steps: int = 300_000
    batch_size: int = 256
    learning_rate: float = 2e-4
    drop_at: int = 200_000
    drop: float = 0.05
    weight_decay: float = 0.0

    def __post_init__(self) -> None:
        require_positive(self, "steps", "batch_size")


@dataclass(frozen=True)
class PublishedConfig:
    """`weights`: T2M-GPT's own checkpoint, used instead of training; overrides the sizes here.
    `statistics`: the folder of its mean.npy and std.npy (the evaluator's), which the field doesn't need."""

    weights: str = ""
    statistics: str = ""


@dataclass(frozen=True)
class CodebookConfig:
    """The VQ-VAE whose codes enrich the coordinates: T2M-GPT's (Zhang et al. 2023a; appendix B.1)."""

    where: str = "split = 'train'"
    fps: int = 20
    window_frames: int = 64
    network: CodebookNetworkConfig = field(default_factory=CodebookNetworkConfig)
    loss: CodebookLossConfig = field(default_factory=CodebookLossConfig)
    schedule: CodebookScheduleConfig = field(default_factory=CodebookScheduleConfig)
    published: PublishedConfig = field(default_factory=PublishedConfig)
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        parse_fps(self.fps)
        require_positive(self, "window_frames")


TimeEncoding = Literal["none", "raw", "fourier", "codebook"]
LatentLayout = Literal["global", "local"]
Activation = Literal["relu", "silu", "gelu"]


@dataclass(frozen=True)
class WindowsConfig:
    """How sequences are cut into windows of at most `max_duration_seconds` (l_max), one every `stride_seconds`."""

    max_duration_seconds: float = 10.0
    min_duration_seconds: float = 0.5
    stride_seconds: float = 10.0
    mirrored: bool = False

    def __post_init__(self) -> None:
        require_positive(self, "max_duration_seconds", "stride_seconds")


@dataclass(frozen=True)
class ClipsConfig:
    """Which poses of a window a training step samples.

    During the first `warmup_fraction` of the steps poses are sampled at `warmup_fps`, then at native framerates or
    integer fractions of them down to `lowest_fps`. `fixed_fps` is Table 1's "NeRM-fixed": all poses are sampled at that
    framerate (an integer, a decimal or a fraction such as 30000/1001), and slower sequences are dropped.
    """

    num_poses: int = 32
    contiguous: bool = True
    seconds_per_visit: float = 10.0
    warmup_fps: int = 20
    warmup_fraction: float = 0.5
    lowest_fps: float | None = None
    fixed_fps: str | None = None

    def __post_init__(self) -> None:
        require_positive(self, "num_poses")
        for fps in (self.warmup_fps, self.lowest_fps, self.fixed_fps):
            if fps is not None:
                parse_fps(fps)

    @property
    def fixed_framerate(self) -> Fraction | None:
        """`fixed_fps` as an exact fraction; None for continuous-framerate training."""
        return None if self.fixed_fps is None else parse_fps(self.fixed_fps)


@dataclass(frozen=True)
class LatentsConfig:
    """Latents N(μ, Σ) of the windows, of `dimension` numbers (d).

    The layout `local` reads z as banks of knots along time (nerm/latents/local.py): bank i has knots[i] knots of
    knot_numbers[i] pose components each; `path_knots` knots hold the body's path (0: no such bank). `kernel`, `radius`
    and `modes` define the basis functions. `initialisation` is that of μ, `ridge` is used in the linear model's fit.
    """

    layout: LatentLayout = "global"
    dimension: int = 256
    knots: tuple[int, ...] = (16,)
    knot_numbers: tuple[int, ...] = (16,)
    path_knots: int = 0
    kernel: Literal["hann", "lanczos"] = "hann"
    radius: float = 2.0
    modes: int = 2
    variational: bool = True
    initial_log_variance: float = -6.0
    initialisation: Literal["normal", "ridge"] = "normal"
    ridge: float = 1e-2

    def __post_init__(self) -> None:
        if self.layout == "global":
            if self.initialisation == "ridge":
                raise ValueError("initialisation=ridge needs layout=local")
            return
        if len(self.knots) != len(self.knot_numbers) or not self.knots:
            raise ValueError(
                f"knots and knot_numbers need one value per bank, not {self.knots} and {self.knot_numbers}"
            )
        banks = zip((*self.knots, self.path_knots), (*self.knot_numbers, 3), strict=True)
        total = sum(knots * numbers for knots, numbers in banks)
        if self.dimension != total:
            raise ValueError(
                f"knots={self.knots} of knot_numbers={self.knot_numbers} and path_knots={self.path_knots} of 3 make "
                f"dimension={total}, not {self.dimension}"
            )

    @property
    def has_path(self) -> bool:
        """Whether z has a path bank."""
        return self.layout == "local" and self.path_knots > 0


@dataclass(frozen=True)
class EncoderConfig:
    """The time encoding (`kind`) and the framerate's scale.

    `raw` is t itself (Table 5's "no time encoding"), `none` no coordinate; `coordinates=frames` uses frame numbers
    (Table 9). `num_queries`, `num_heads` and `num_layers` belong to the codebook-coordinate attention (CCA).
    """

    kind: TimeEncoding = "codebook"
    coordinates: Literal["normalised", "frames"] = "normalised"
    num_frequencies: int = 64
    frequency_scale: float = 4.0
    framerate_scale: float = 0.2
    num_queries: int = 256
    num_heads: int = 4
    num_layers: int = 3

    @property
    def query_width(self) -> int:
        """Width of CCA's queries: that of γ(t), to which its output is added (the paper's 128 for R = 64)."""
        return 2 * self.num_frequencies


@dataclass(frozen=True)
class DecoderConfig:
    """The network from a latent and a coordinate to a pose; a transformer has as many heads as the encoder.

    With `linear_path` it is initialised as the linear model of the local latents.
    """

    kind: Literal["mlp", "transformer"] = "mlp"
    width: int = 1024
    num_layers: int = 9
    activation: Activation = "relu"
    linear_path: bool = False


@dataclass(frozen=True)
class FieldLossConfig:
    """The weight of the KL term, and the scaling of pose errors (`measure_scaling`)."""

    kl_weight: float = 1e-4
    scaling: Literal["number", "group"] = "number"
    root_weight: float = 1.0


@dataclass(frozen=True)
class ContactsConfig:
    """Contact as an output of the field (`nerm.field.contact`), trained after it in `steps` steps; 0: no such output.

    It needs local latents. Latents get noise of up to `noise` standard deviations of the denoiser's space.
    """

    steps: int = 0
    batch_size: int = 256
    learning_rate: float = 3e-3
    width: int = 128
    noise: float = 0.4

    def __post_init__(self) -> None:
        require_positive(self, "batch_size", "width")
        if self.steps < 0:
            raise ValueError(f"steps must be 0 or more, not {self.steps}")


@dataclass(frozen=True)
class FieldOptimizerConfig:
    """Further learning rates of AdamW: for attention and for the latents (μ and log Σ)."""

    attention_learning_rate: float = 1e-4
    latent_learning_rate: float = 1e-4
    weight_decay: float = 0.01


@dataclass(frozen=True)
class FieldConfig:
    """The variational implicit representation (paper §3.1, B, D); lengths in seconds, rates in frames a second.

    `pose_vectors` is the representation of a pose (motionkit/data/pose_vectors/): positions, the published 263
    numbers, or SMPL's rotations.
    """

    where: str = "split = 'train'"
    pose_vectors: PoseVectorsName = "field"
    windows: WindowsConfig = field(default_factory=WindowsConfig)
    clips: ClipsConfig = field(default_factory=ClipsConfig)
    latents: LatentsConfig = field(default_factory=LatentsConfig)
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    decoder: DecoderConfig = field(default_factory=DecoderConfig)
    loss: FieldLossConfig = field(default_factory=FieldLossConfig)
    schedule: Schedule = field(default_factory=lambda: Schedule(epochs=20_000, batch_size=4096))
    optimizer: FieldOptimizerConfig = field(default_factory=FieldOptimizerConfig)
    contacts: ContactsConfig = field(default_factory=ContactsConfig)
    precision: Precision = "float32"
    compile: bool = False

    def __post_init__(self) -> None:
        latents = self.latents
        if latents.layout == "local" and self.encoder.coordinates == "frames":
            raise ValueError(
                "local latents need normalised coordinates: frame numbers (Table 9) need latents.layout=global"
            )
        if latents.layout == "global" and self.decoder.linear_path:
            raise ValueError("decoder.linear_path needs latents.layout=local")
        if latents.has_path and self.pose_vectors != "field":
            raise ValueError(
                f"a path bank needs positions: pose_vectors={self.pose_vectors} needs latents.path_knots=0 and "
                f"latents.dimension={latents.dimension - 3 * latents.path_knots}"
            )
        if latents.has_path and self.loss.scaling != "group":
            raise ValueError("a path bank rotates poses, so x and z need the same scale: loss.scaling=group")


PathNumbers = Literal["places", "steps"]
LatentScale = Literal["number", "component"]


@dataclass(frozen=True)
class TransformerConfig:
    """Sizes of the denoiser; the defaults are the `paper` recipe's.

    `latent_tokens` splits z into that many tokens of equal size: 1 as in the paper, or more with local latents, which
    are ordered by time, so that each token is a stretch of the motion.
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
class LatentSpaceConfig:
    """The space of the diffusion for local latents (`nerm.denoiser.latent_space`).

    `path` represents the body's path as positions or as the steps between them; `scale` standardises each number of z
    by itself, or each component over all knots.
    """

    path: PathNumbers = "places"
    scale: LatentScale = "number"


@dataclass(frozen=True)
class ConditionsConfig:
    """The conditions of the denoiser.

    `text_encoder` is a name for `motionkit.training.text.load_text_encoder`, or "none" to train without texts;
    `text_dimension` is the required size of its embeddings (None: any). Conditions are dropped with probability `drop`;
    windows with a caption and an action get the action with probability `action_share`. Up to `paraphrases` rule-based
    rewordings of each caption are drawn once (`nerm.text.paraphrases`) and stand for it in half of its uses.
    """

    text_encoder: str = "minilm"
    text_dimension: int | None = None
    drop: float = 0.1
    action_share: float = 0.25
    paraphrases: int = 0

    def __post_init__(self) -> None:
        for name in ("drop", "action_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must lie in [0, 1], not {getattr(self, name)}")
        if self.paraphrases < 0:
            raise ValueError(f"paraphrases must be 0 or more, not {self.paraphrases}")


@dataclass(frozen=True)
class DenoiserConfig:
    """The stage `denoiser`; `ema_decay` is the decay of the weights' moving average (0: none)."""

    network: TransformerConfig = field(default_factory=TransformerConfig)
    diffusion: DiffusionConfig = field(default_factory=DiffusionConfig)
    latents: LatentSpaceConfig = field(default_factory=LatentSpaceConfig)
    conditions: ConditionsConfig = field(default_factory=ConditionsConfig)
    schedule: Schedule = field(default_factory=lambda: Schedule(epochs=3000))
    weight_decay: float = 0.01
    ema_decay: float = 0.0
    precision: Precision = "float32"
    compile: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.ema_decay < 1.0:
            raise ValueError(f"ema_decay must lie in [0, 1), not {self.ema_decay}")
