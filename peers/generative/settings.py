"""Settings of generative peers: what is common to all, and sizes of the networks; imports nothing heavy.

Defaults of the sizes are the published ones.
"""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal, Protocol, runtime_checkable

from motionkit.clips.pose_vectors import PoseVectorsName
from motionkit.core.framerate import parse_fps
from motionkit.training.config import ConfigLike, Precision, Schedule, require_positive
from motionkit.training.diffusion.settings import DiffusionConfig


@dataclass(frozen=True)
class MotionsConfig:
    """What is learnt: pose vectors of crops at `fps`, of `max_frames` at most.

    Crops lie in windows that begin every `stride_seconds` of a sequence and last `min_seconds` at least; as HumanML3D's
    readers do, their lengths are whole multiples of `crop_multiple` frames, in one of three cases one multiple less
    than would fit. With `crops="whole"` a crop is its whole window. Of a crop a network sees all frames, or
    `seen_frames` of them: a random stretch, or frames scattered over it (the same one perhaps twice).
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
        """The longest motion: as published vectors do, each frame stands for the time to the next pose."""
        return float(self.max_frames / self.framerate)


@dataclass(frozen=True)
class ConditionsConfig:
    """What motions are conditioned on; with probability `drop` nothing, so that guidance has what it needs.

    `nothing` says what a text is replaced by: zeros in place of its embedding, or the embedding of the empty text.
    `scaled` brings embeddings of length 1 to a root mean square of 1, which CLIP's own are nearer to.
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
    """AdamW; `ema_decay` above 0 keeps an average of the weights, which is what generates; `clip_norm` above 0 is the
    longest gradient."""

    weight_decay: float = 0.0
    ema_decay: float = 0.0
    clip_norm: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.ema_decay < 1.0:
            raise ValueError(f"ema_decay must lie in [0, 1), not {self.ema_decay}")


@runtime_checkable
class PeerConfig(ConfigLike, Protocol):
    """A stage's configuration; its part `network` is the peer's own."""

    @property
    def motions(self) -> MotionsConfig:
        """What is learnt."""
        ...

    @property
    def conditions(self) -> ConditionsConfig:
        """Under which conditions."""
        ...

    @property
    def schedule(self) -> Schedule:
        """How long."""
        ...

    @property
    def optimizer(self) -> OptimizerConfig:
        """By which steps."""
        ...

    @property
    def precision(self) -> Precision:
        """In which number format."""
        ...


@dataclass(frozen=True)
class TransformerSizes:
    """Layers of torch's kind: post-norm, GELU."""

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
    """INR-MLP: codes of `code` numbers, an MLP of these widths; `reseeds` says how often a mixture that copies
    training motions is fitted again."""

    code: int = 128
    time_features: int = 256
    hidden: tuple[int, ...] = (1000, 500, 500, 200, 100)
    root_weight: float = 1.0
    kl_weight: float = 1e-5
    reseeds: int = 10


@dataclass(frozen=True)
class T2mAutoencoderNetworkConfig:
    """T2M's autoencoder of movements: convolutions to one snippet for four frames, and back."""

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
    """JL2P: the width of its cells; of `mean_first` of the motions it is told no first pose.

    Training sees so many frames as one after another of `lengths` says over the share `curriculum` of its steps, and
    the last of these from there on.
    """

    width: int = 1024
    lengths: tuple[int, ...] = (2, 4, 8, 16)
    curriculum: float = 0.5
    mean_first: float = 0.0


@dataclass(frozen=True)
class HierNetworkConfig:
    """Hier: widths of body parts, of limbs with the trunk, of the codes of both halves, and of a critic's layers.

    Of `mean_first` of the motions it is told no first pose.
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
    """NeMF's predictor of the root's motion: widths of its convolutions, and how many frames one sees."""

    widths: tuple[int, ...] = (512, 512, 512, 512, 256, 128)
    kernel: int = 15
    contact_weight: float = 0.5


@dataclass(frozen=True)
class NemfNetworkConfig:
    """NeMF: a field over `frames` frames of two latents, and encoders of such clips; `frequencies` are those of time.

    KL's weight grows from a hundredth in the first half of each of `kl_cycles` parts of the training.
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
    """CAMDM: a transformer encoder makes `future` frames after `past` ones, with probability `no_past` after none."""

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
    """ACMDM's small form: a transformer of these sizes, sampled by so many Euler steps."""

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(8, 512, 8, 1365))
    sampling_steps: int = 50
    guidance_scale: float = 3.0


@dataclass(frozen=True)
class MdmNetworkConfig:
    """MDM: a transformer encoder over frames behind one token of time and condition, which predicts the clean motion.

    1,000 steps as published first, all of them sampled; `mdm-50` is the separately trained one of 50.
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
    """MLD's VAE: transformers with long skips to one latent of the transformer's width and back.

    `longest` is how many learned positions there are.
    """

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(9, 256, 4, 1024))
    longest: int = 500
    joint_weight: float = 1.0
    kl_weight: float = 1e-4


@dataclass(frozen=True)
class MldNetworkConfig:
    """MLD's denoiser over the tokens latent, time and condition; `time_features` are the sinusoids of a step.

    Training draws `noises` for each latent: making a latent costs far more than the denoiser does.
    """

    transformer: TransformerSizes = field(default_factory=lambda: TransformerSizes(9, 256, 4, 1024))
    time_features: int = 768
    noises: int = 1
    diffusion: DiffusionConfig = field(default_factory=lambda: DiffusionConfig(sampling_spacing="leading"))
