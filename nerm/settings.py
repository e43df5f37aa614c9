"""Settings of the stages `codebook`, `field` and `denoiser`, nested as their parts are (no torch)."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import reduce
from typing import Any, Literal, TypeVar

from motionkit.core.timegrid import parse_fps
from motionkit.features.convention import PoseVectorsName
from motionkit.training.config import DiffusionConfig, Precision, Schedule, flatten, from_plain, require_positive


@dataclass(frozen=True)
class CodebookNetworkConfig:
    """Sizes of the VQ-VAE."""

    width: int = 512
    code_dimension: int = 512
    num_codes: int = 512


@dataclass(frozen=True)
class CodebookScheduleConfig:
    """Steps, windows per step, and the learning rate, which falls to a twentieth at step `drop_at`."""

    steps: int = 300_000
    batch_size: int = 256
    learning_rate: float = 2e-4
    drop_at: int = 200_000

    def __post_init__(self) -> None:
        require_positive(self, "steps", "batch_size")


@dataclass(frozen=True)
class PublishedConfig:
    """`weights`: T2M-GPT's own checkpoint, whose codes are used instead of training."""

    weights: str = ""


@dataclass(frozen=True)
class CodebookConfig:
    """The VQ-VAE whose codes enrich the coordinates: T2M-GPT's (Zhang et al. 2023a; appendix B.1)."""

    where: str = "split = 'train'"
    window_frames: int = 64
    network: CodebookNetworkConfig = field(default_factory=CodebookNetworkConfig)
    schedule: CodebookScheduleConfig = field(default_factory=CodebookScheduleConfig)
    published: PublishedConfig = field(default_factory=PublishedConfig)
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        require_positive(self, "window_frames")


TimeEncoding = Literal["none", "raw", "fourier", "codebook"]
LatentLayout = Literal["global", "local"]
Activation = Literal["relu", "silu"]


@dataclass(frozen=True)
class WindowsConfig:
    """How sequences are cut into windows of at most `max_duration_seconds` (l_max), one every `stride_seconds`."""

    max_duration_seconds: float = 10.0
    stride_seconds: float = 10.0
    mirrored: bool = False

    def __post_init__(self) -> None:
        require_positive(self, "max_duration_seconds", "stride_seconds")


@dataclass(frozen=True)
class ClipsConfig:
    """Which poses of a window a training step samples.

    During the first `warmup_fraction` of the steps poses are sampled at 20 fps, then at native framerates or integer
    fractions of them down to `lowest_fps`. `fixed_fps` is Table 1's "NeRM-fixed": all poses are sampled at that
    framerate (an integer, a decimal or a fraction such as 30000/1001), and slower sequences are dropped.
    """

    num_poses: int = 32
    contiguous: bool = True
    seconds_per_visit: float = 10.0
    warmup_fraction: float = 0.5
    lowest_fps: float | None = None
    fixed_fps: str | None = None

    def __post_init__(self) -> None:
        require_positive(self, "num_poses")
        for fps in (self.lowest_fps, self.fixed_fps):
            if fps is not None:
                parse_fps(fps)

    @property
    def fixed_framerate(self) -> Fraction | None:
        """`fixed_fps` as an exact fraction; None for continuous-framerate training."""
        return None if self.fixed_fps is None else parse_fps(self.fixed_fps)


@dataclass(frozen=True)
class LatentsConfig:
    """Latents N(μ, Σ) of the windows: in the layout `global` of `dimension` numbers (d).

    The layout `local` reads z as banks of knots along time (nerm/latents.py): bank i has knots[i] knots of
    knot_numbers[i] pose components each; `path_knots` knots hold the body's path (0: no such bank). `kernel`, `radius`
    and `modes` define the basis functions, `ridge` the fit of the linear model that local latents start from.
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
    ridge: float = 1e-2

    def __post_init__(self) -> None:
        if len(self.knots) != len(self.knot_numbers) or not self.knots:
            raise ValueError(
                f"knots and knot_numbers need one value per bank, not {self.knots} and {self.knot_numbers}"
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
    """The network from a latent and a coordinate to a pose."""

    kind: Literal["mlp", "transformer"] = "mlp"
    width: int = 1024
    num_layers: int = 9
    activation: Activation = "relu"


@dataclass(frozen=True)
class FieldLossConfig:
    """The weight of the KL term, and the scaling of pose errors (`measure_scaling`)."""

    kl_weight: float = 1e-4
    scaling: Literal["number", "group"] = "number"
    root_weight: float = 1.0


@dataclass(frozen=True)
class FieldOptimizerConfig:
    """Further learning rates of AdamW: for attention and for the latents (μ and log Σ)."""

    attention_learning_rate: float = 1e-4
    latent_learning_rate: float = 1e-4
    weight_decay: float = 0.01


@dataclass(frozen=True)
class FieldConfig:
    """The variational implicit representation (paper §3.1, B, D); lengths in seconds, rates in frames a second.

    `pose_vectors` is the representation of a pose (motionkit/features): positions, the published 263 numbers, or
    SMPL's rotations. `contact_steps` are those of the contact head, which needs local latents (0: none).
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
    contact_steps: int = 0
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        latents = self.latents
        if latents.layout == "local" and self.encoder.coordinates == "frames":
            raise ValueError(
                "local latents need normalised coordinates: frame numbers (Table 9) need latents.layout=global"
            )
        if self.contact_steps < 0:
            raise ValueError(f"contact_steps must be 0 or more, not {self.contact_steps}")
        if latents.has_path and self.pose_vectors != "field":
            raise ValueError(
                f"a path bank needs positions: pose_vectors={self.pose_vectors} needs latents.path_knots=0"
            )
        if latents.has_path and self.loss.scaling != "group":
            raise ValueError("a path bank rotates poses, so x and z need the same scale: loss.scaling=group")


LatentScale = Literal["number", "component"]


@dataclass(frozen=True)
class TransformerConfig:
    """Sizes of the denoiser; the defaults are the `paper` recipe's.

    `latent_tokens` splits z into that many tokens of equal size: 1 as in the paper, or more with local latents, which
    are ordered by time, so that each token is a segment of the motion.
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
class ConditionsConfig:
    """The texts that condition the denoiser.

    `text_encoder` is a name for `motionkit.training.text.load_text_encoder`, or "none" to train without texts. Up to
    `paraphrases` rule-based rewordings of each caption are drawn once and stand for it in half of its uses.
    """

    text_encoder: str = "minilm"
    paraphrases: int = 0

    def __post_init__(self) -> None:
        if self.paraphrases < 0:
            raise ValueError(f"paraphrases must be 0 or more, not {self.paraphrases}")


@dataclass(frozen=True)
class DenoiserConfig:
    """The stage `denoiser` (paper §3.2, D).

    `latent_scale` standardises each number of z by itself, or each component over all knots of local latents;
    `ema_decay` is the decay of the weights' moving average (0: none).
    """

    network: TransformerConfig = field(default_factory=TransformerConfig)
    diffusion: DiffusionConfig = field(default_factory=DiffusionConfig)
    latent_scale: LatentScale = "number"
    conditions: ConditionsConfig = field(default_factory=ConditionsConfig)
    schedule: Schedule = field(default_factory=lambda: Schedule(epochs=3000))
    ema_decay: float = 0.0
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        if not 0.0 <= self.ema_decay < 1.0:
            raise ValueError(f"ema_decay must lie in [0, 1), not {self.ema_decay}")


# Settings that were renamed, and those that became constants, of runs trained before.
_RENAMED = {"contacts.steps": "contact_steps", "latents.scale": "latent_scale"}
_CONSTANTS: dict[str, tuple[Any, ...]] = {
    **{"windows.min_duration_seconds": (0.5,), "clips.warmup_fps": (20,), "latents.path": ("steps", "places")},
    **{"latents.initialisation": ("normal", "ridge"), "decoder.linear_path": (False, True), "compile": (False, True)},
    **{"contacts.batch_size": (256,), "contacts.learning_rate": (3e-3,), "contacts.width": (128,)},
    **{"contacts.noise": (0.4,), "conditions.text_dimension": (None, 768), "conditions.drop": (0.1,)},
    **{"conditions.action_share": (0.25,), "weight_decay": (0.01,)},
    **{"fps": (20,), "network.residual_layers": (3,), "network.ema_decay": (0.99,), "network.reset_below": (1.0,)},
    **{"loss.position_weight": (0.5,), "loss.commitment_weight": (0.02,), "schedule.drop": (0.05,)},
    **{"schedule.weight_decay": (0.0,), "published.statistics": ("",)},
}


StageConfig = TypeVar("StageConfig", CodebookConfig, FieldConfig, DenoiserConfig)


def from_recorded(config_type: type[StageConfig], values: Mapping[str, Any]) -> StageConfig:
    """A stage's settings as a run's file holds them.

    Reads those of runs from before settings became constants too, if they had the constants' values; raises
    `UsageError` for others, as `from_plain` does.
    """
    known, recorded = flatten(config_type()), dict(_leaves(values))
    nested: dict[str, Any] = {}
    for name, value in recorded.items():
        key = _RENAMED.get(name, name)
        if key in known or key not in _CONSTANTS or value not in _CONSTANTS[key]:
            *parents, last = key.split(".")
            reduce(lambda table, parent: table.setdefault(parent, {}), parents, nested)[last] = value
    return from_plain(config_type, nested)


def _leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value
