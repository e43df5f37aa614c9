"""Settings of NeRM and its named recipes: `paper` (the paper's figures), `base` (an hour on a GPU), `nano` and `demo`
(minutes on two cores).

Ablations of the paper are values here, not forks of the code: Table 1's "NeRM-fixed" `field.fixed_fps`, Table 5
`field.time_encoding`, Table 6 `field.variational`, Table 7 `field.decoder`, Table 8 `field.latent_dimension` and
`field.kl_weight`, Table 9 `field.coordinates`.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

from motionkit.timegrid import parse_fps
from motionkit.training.config import Precision
from nerm.denoiser_config import DenoiserConfig, DiffusionConfig, TransformerConfig

TimeEncoding = Literal["none", "raw", "fourier", "codebook"]
LatentLayout = Literal["global", "local"]
PoseVectorsName = Literal["field", "native", "rotations"]
Activation = Literal["relu", "silu", "gelu"]


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
    # What is learnt at each instant (nerm/pose_vectors.py): positions, the published 263 numbers, SMPL's rotations.
    pose_vectors: PoseVectorsName = "field"
    # Latents: N(μ, Σ) per window. `local` reads z as banks of knots along time (nerm/local_latents.py): bank i has
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


@dataclass(frozen=True)
class NermConfig:
    """All stages of NeRM."""

    codebook: CodebookConfig = dataclasses.field(default_factory=CodebookConfig)
    field: FieldConfig = dataclasses.field(default_factory=FieldConfig)
    denoiser: DenoiserConfig = dataclasses.field(default_factory=DenoiserConfig)


def paper() -> NermConfig:
    """The paper's figures (§3, B.1, D), with what ../docs/deviations.md says where it is silent."""
    return NermConfig(denoiser=DenoiserConfig(text_encoder="clip", text_dimension=768))


def nano() -> NermConfig:
    """Two CPU cores and minutes: smaller networks, local latents, the settings that docs/results measured."""
    codebook = CodebookConfig(
        width=128, code_dimension=128, num_codes=256, steps=600, batch=48, rate=1e-3, rate_drop_at=480
    )
    return NermConfig(codebook=codebook, field=_local_field(steps=8000), denoiser=_knot_denoiser(steps=2500))


def base() -> NermConfig:
    """One GPU of the H100's kind for an hour: `nano` at the paper's widths; docs/nerm.md counts the FLOPs."""
    codebook = CodebookConfig(steps=20_000, rate_drop_at=13_000, precision="auto")
    field = dataclasses.replace(
        nano().field,
        mirrored=True,
        num_queries=256,
        hidden=1024,
        steps=60_000,
        batch=4096,
        rate=2e-3,
        attention_rate=5e-4,
    )
    denoiser = dataclasses.replace(
        nano().denoiser,
        network=TransformerConfig(num_layers=9, width=512, num_heads=8, ffn_width=2048, dropout=0.1, latent_tokens=16),
        batch=256,
        steps=80_000,
        rate=3e-4,
        ema_decay=0.9999,
        precision="auto",
    )
    return NermConfig(codebook=codebook, field=field, denoiser=denoiser)


def demo() -> NermConfig:
    """Three minutes on the embedded corpus: `nano` with a smaller codebook, sparser windows and fewer steps."""
    codebook = CodebookConfig(
        width=64, code_dimension=64, num_codes=128, steps=120, batch=32, rate=1e-3, rate_drop_at=100
    )
    return NermConfig(
        codebook=codebook,
        field=_local_field(steps=1200, stride_seconds=5.0),
        denoiser=_knot_denoiser(steps=1000),
    )


def _local_field(*, steps: int, stride_seconds: float = 2.0) -> FieldConfig:
    return FieldConfig(
        stride_seconds=stride_seconds,
        latent_layout="local",
        latent_dimension=768,
        knots=(32, 16),
        knot_numbers=(16, 13),
        path_knots=16,
        knot_kernel="lanczos",
        knot_radius=3.0,
        knot_modes=3,
        initial_log_variance=-8.0,
        initialisation="ridge",
        ridge=0.02,
        num_queries=64,
        hidden=256,
        activation="silu",
        linear_path=True,
        framerate_scale=0.05,
        scaling="group",
        root_weight=4.0,
        epochs=None,
        steps=steps,
        batch=256,
        num_poses=8,
        contiguous=False,
        seconds_per_visit=2.5,
        warmup_fraction=0.02,
        lowest_fps=20.0,
        rate=8e-3,
        attention_rate=1e-3,
        latent_rate=1e-2,
        weight_decay=0.0,
        schedule="cosine",
        # At full rate the first steps undo the start from the linear model, which the next hundred have to win back.
        rate_warmup_fraction=0.05,
        precision="auto",
    )


def _knot_denoiser(*, steps: int) -> DenoiserConfig:
    return DenoiserConfig(
        network=TransformerConfig(num_layers=5, width=192, ffn_width=512, dropout=0.0, latent_tokens=8),
        diffusion=DiffusionConfig(prediction="velocity", loss="velocity"),
        path="steps",
        latent_scale="component",
        guidance_scale=1.5,
        batch=64,
        steps=steps,
        epochs=None,
        rate=2e-3,
        schedule="cosine",
        rate_warmup_fraction=0.02,
        ema_decay=0.995,
    )


RECIPES: dict[str, Callable[[], NermConfig]] = {"nano": nano, "demo": demo, "base": base, "paper": paper}
