"""Configuration of the generative peers: common settings and network sizes; imports nothing heavy.

Defaults of the sizes are the published ones.
"""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal, Protocol, runtime_checkable

from motionkit.core.timegrid import parse_fps
from motionkit.features.convention import PoseVectorsName
from motionkit.training.config import ConfigLike, Precision, Schedule, require_positive
from motionkit.training.diffusion.settings import DiffusionConfig


@dataclass(frozen=True)
class MotionsConfig:
    """The training motions: pose vectors of crops at `fps`, of at most `max_frames` frames.

    Windows begin every `stride_seconds` of a sequence and last at least `min_seconds`. As in HumanML3D's data loaders,
    crop lengths are multiples of `crop_multiple` frames, one multiple shorter than fits with probability 1/3. With
    `crops="whole"` a crop is its whole window. The network sees all frames of a crop, or `seen_frames` of them: a
    random stretch, or frames scattered over it (with replacement).
    """

    pose_vectors: PoseVectorsName = "native"
    fps: float = 20.0
    max_frames: int = 196
    min_seconds: float = 2.0
    stride_seconds: float = 2.0
    mirrored: bool = True
    crop_multiple: int = 4
    crops: Literal["random", "whole"] = "random"
    seen: Literal["all", "stretch", "scattered"] = "all"
    seen_frames: int = 0
    where: str = "split = 'train'"

    def __post_init__(self) -> None:
        require_positive(self, "fps", "min_seconds", "stride_seconds", "crop_multiple")
        if self.max_frames < 2:
            raise ValueError(f"max_frames must be 2 or more, not {self.max_frames}")
        if (self.seen == "all") != (self.seen_frames == 0):
            raise ValueError(f"seen={self.seen} with seen_frames={self.seen_frames}: all with 0, else above 0")

    @property
    def framerate(self) -> Fraction:
        """`fps` as an exact fraction."""
        return parse_fps(self.fps)

    @property
    def max_duration_seconds(self) -> float:
        """The longest motion; as in the published vectors, a frame lasts until the next pose."""
        return float(self.max_frames / self.framerate)


@dataclass(frozen=True)
class ConditionsConfig:
    """What motions are conditioned on, dropped with probability `drop` for classifier-free guidance.

    `nothing` is the null embedding: zeros, or the embedding of the empty text. `scaled` rescales unit-norm embeddings
    to a root mean square of 1, which CLIP's unnormalised ones are near to.
    """

    kind: Literal["text", "action", "none"] = "text"
    text_encoder: str = "clip"
    drop: float = 0.1
    nothing: Literal["zeros", "empty"] = "zeros"
    scaled: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.drop < 1.0:
            raise ValueError(f"drop must lie in [0, 1), not {self.drop}")


@dataclass(frozen=True)
class OptimizerConfig:
    """AdamW; `ema_decay` above 0 saves an exponential moving average of the weights; `clip_norm` above 0 clips the
    gradient's norm."""

    weight_decay: float = 0.0
    ema_decay: float = 0.0
    clip_norm: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.ema_decay < 1.0:
            raise ValueError(f"ema_decay must lie in [0, 1), not {self.ema_decay}")


@runtime_checkable
class PeerConfig(ConfigLike, Protocol):
    """A stage's configuration; its part `network` is specific to the peer."""

    @property
    def motions(self) -> MotionsConfig:
        """The training motions."""
        ...

    @property
    def conditions(self) -> ConditionsConfig:
        """The conditions."""
        ...

    @property
    def schedule(self) -> Schedule:
        """Steps, batch size and learning rate."""
        ...

    @property
    def optimizer(self) -> OptimizerConfig:
        """The optimiser."""
        ...

    @property
    def precision(self) -> Precision:
        """The number format."""
        ...


@dataclass(frozen=True)
class TransformerSizes:
    """Sizes of torch's transformer layers: post-norm, GELU."""

    layers: int
    width: int
    heads: int
    inner: int
    dropout: float = 0.1


@dataclass(frozen=True)
class ActorNetworkConfig:
    """ACTOR: transformers of these sizes to one latent of their width and back."""

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(8, 256, 4, 1024))
    joint_weight: float = 1.0
    kl_weight: float = 1e-5


@dataclass(frozen=True)
class InrMlpNetworkConfig:
    """INR-MLP: size of the codes and widths of the MLP; `reseeds` is how often a mixture that copies training motions
    is fitted again."""

    code: int = 128
    time_features: int = 256
    hidden: tuple[int, ...] = (1000, 500, 500, 200, 100)
    root_weight: float = 1.0
    kl_weight: float = 1e-5
    reseeds: int = 10


@dataclass(frozen=True)
class T2mAutoencoderNetworkConfig:
    """T2M's movement autoencoder: convolutions between four frames and one snippet."""

    width: int = 512
    dropout: float = 0.2
    size_weight: float = 1e-3
    change_weight: float = 1e-3


@dataclass(frozen=True)
class T2mNetworkConfig:
    """T2M's temporal VAE: widths of its cells, of the text's vector and of a snippet's latent.

    Training sees `first_units` snippets of a motion, and `last_units` after the share `curriculum` of its steps.
    """

    width: int = 1024
    value: int = 512
    latent: int = 128
    kl_weight: float = 0.01
    teacher_forcing: float = 0.4
    first_units: int = 10
    last_units: int = 49
    curriculum: float = 0.5


@dataclass(frozen=True)
class Jl2pNetworkConfig:
    """JL2P: the width of its GRU; with probability `mean_first` the first pose is replaced by the mean pose.

    Over the share `curriculum` of the steps, training uses the numbers of frames in `lengths` in turn, then the last.
    """

    width: int = 1024
    lengths: tuple[int, ...] = (2, 4, 8, 16)
    curriculum: float = 0.5
    mean_first: float = 0.0


@dataclass(frozen=True)
class HierNetworkConfig:
    """Hier: widths of body parts, of limbs with the trunk, of the codes of both halves, and of the critic's layers.

    With probability `mean_first` the first pose is replaced by the mean pose.
    """

    part: int = 32
    limb: int = 128
    width: int = 512
    critic: tuple[int, ...] = (64, 256, 128, 64)
    change_weight: float = 0.1
    match_weight: float = 0.1
    kept_weight: float = 1e-3
    critic_weight: float = 1e-3
    mean_first: float = 0.0


@dataclass(frozen=True)
class NemfPathNetworkConfig:
    """NeMF's predictor of the root's motion: widths and kernel size of its convolutions."""

    widths: tuple[int, ...] = (512, 512, 512, 512, 256, 128)
    kernel: int = 15
    contact_weight: float = 0.5


@dataclass(frozen=True)
class NemfNetworkConfig:
    """NeMF: a field over `frames` frames with two latents, and their encoders; `frequencies` encode time.

    KL's weight is annealed in `kl_cycles` cycles: it grows from a hundredth in the first half of each.
    """

    frames: int = 128
    widths: tuple[int, ...] = (128, 256, 512, 512)
    kernel: int = 4
    local_latent: int = 1024
    turn_latent: int = 256
    frequencies: int = 7
    width: int = 1024
    local_layers: int = 8
    turn_layers: int = 3
    joint_weight: float = 10.0
    kl_weight: float = 1e-5
    kl_cycles: int = 20

    def __post_init__(self) -> None:
        if self.frames % 2 ** len(self.widths):
            raise ValueError(f"frames must be a multiple of {2 ** len(self.widths)}, not {self.frames}")


@dataclass(frozen=True)
class CamdmNetworkConfig:
    """CAMDM: predicts `future` frames from `past` ones, which are dropped with probability `no_past`."""

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(4, 256, 4, 1024))
    past: int = 10
    future: int = 45
    no_past: float = 0.15
    diffusion: DiffusionConfig = field(
        default_factory=lambda: DiffusionConfig(
            num_steps=4,
            schedule="cosine",
            prediction="latent",
            loss="latent",
            sampler="ddpm",
            sampling_steps=4,
            guidance_scale=1.0,
        )
    )


@dataclass(frozen=True)
class FlowNetworkConfig:
    """ACMDM's small form: a transformer of these sizes, sampled by `sampling_steps` Euler steps."""

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(8, 512, 8, 1365))
    sampling_steps: int = 50
    guidance_scale: float = 3.0


@dataclass(frozen=True)
class MdmNetworkConfig:
    """MDM: a transformer encoder over one token of time and condition, then frames; predicts the clean motion.

    1,000 steps as first published, all of them sampled; `mdm-50` is trained separately with 50.
    """

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(8, 512, 4, 1024))
    diffusion: DiffusionConfig = field(
        default_factory=lambda: DiffusionConfig(
            schedule="cosine",
            prediction="latent",
            loss="latent",
            sampler="ddpm",
            sampling_steps=1000,
            guidance_scale=2.5,
        )
    )


@dataclass(frozen=True)
class MldVaeNetworkConfig:
    """MLD's VAE: transformers with long skip connections and one latent of the transformer's width.

    `longest` is the number of learned positions.
    """

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(9, 256, 4, 1024))
    longest: int = 500
    joint_weight: float = 1.0
    kl_weight: float = 1e-4


@dataclass(frozen=True)
class MldNetworkConfig:
    """MLD's denoiser over the tokens latent, time and condition; `time_features` is the size of the step embedding.

    Training draws `noises` noise samples per latent, since encoding costs far more than denoising.
    """

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(9, 256, 4, 1024))
    time_features: int = 768
    noises: int = 1
    diffusion: DiffusionConfig = field(default_factory=lambda: DiffusionConfig(sampling_spacing="leading"))
