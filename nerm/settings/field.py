"""Settings of NeRM's first stage: windows, latents, coordinates, decoder and training of the motion field (no torch).

Ablations of the paper are values here, not forks of the code: Table 1's "NeRM-fixed" `fixed_fps`, Table 5
`time_encoding`, Table 6 `variational`, Table 7 `decoder`, Table 8 `latent_dimension` and `kl_weight`, Table 9
`coordinates`.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

from motionkit.timegrid import parse_fps
from motionkit.training.config import Precision

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
