"""NeRM's settings (no torch), its recipes, its stages, how its rows are named, and its ablations.

The settings' defaults are the paper's. Recipes: `paper` (the paper's settings), `base` (an hour on a GPU), `small`
(half an hour of a CPU core), `nano` and `demo` (minutes).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal

from motionkit.core.files import write_whole
from motionkit.core.plugins import lazily
from motionkit.core.timegrid import parse_fps
from motionkit.features.convention import PoseVectorsName
from motionkit.training.ablations import Ablation, Ablations, Variant
from motionkit.training.config import (
    ConfigLike,
    ConfigT,
    DiffusionConfig,
    Precision,
    Schedule,
    apply_overrides,
    flatten,
    from_plain,
    require_positive,
)
from motionkit.training.run import RunFolder, Stage, StageContext, clear_stage


@dataclass(frozen=True)
class CodebookNetworkConfig:
    """The VQ-VAE's width, which is that of its codes, and their number."""

    width: int = 512
    num_codes: int = 512


@dataclass(frozen=True)
class CodebookConfig:
    """The VQ-VAE whose codes enrich the coordinates: T2M-GPT's (Zhang et al. 2023a; appendix B.1).

    `published_weights` is T2M-GPT's own checkpoint, whose codes are used instead of training.
    """

    where: str = "split = 'train'"
    window_frames: int = 64
    network: CodebookNetworkConfig = CodebookNetworkConfig()
    # The learning rate falls to a twentieth at step 200,000.
    schedule: Schedule = Schedule(
        steps=300_000, batch_size=256, learning_rate=2e-4, kind="steps", drop=0.05, drop_every=2 / 3
    )
    published_weights: str = ""
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
        require_positive(self, "num_poses", "lowest_fps")
        assert self.fixed_framerate is None or self.fixed_framerate > 0

    @property
    def fixed_framerate(self) -> Fraction | None:
        """`fixed_fps` as an exact fraction; None for continuous-framerate training."""
        return None if self.fixed_fps is None else parse_fps(self.fixed_fps)


@dataclass(frozen=True)
class LatentsConfig:
    """Latents N(μ, Σ) of the windows: in the layout `global` of `dimension` numbers (d).

    The layout `local` reads z as banks of knots along time (nerm/latents.py): bank i has knots[i] knots of
    knot_numbers[i] pose components each; `path_knots` knots hold the body's path.
    """

    layout: LatentLayout = "global"
    dimension: int = 256
    knots: tuple[int, ...] = (32, 16)
    knot_numbers: tuple[int, ...] = (16, 13)
    path_knots: int = 16
    variational: bool = True
    initial_log_variance: float = -6.0

    def __post_init__(self) -> None:
        if len(self.knots) != len(self.knot_numbers) or not self.knots:
            raise ValueError(
                f"knots and knot_numbers need one value per bank, not {self.knots} and {self.knot_numbers}"
            )


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
    SMPL's rotations.
    """

    where: str = "split = 'train'"
    pose_vectors: PoseVectorsName = "field"
    windows: WindowsConfig = WindowsConfig()
    clips: ClipsConfig = ClipsConfig()
    latents: LatentsConfig = LatentsConfig()
    encoder: EncoderConfig = EncoderConfig()
    decoder: DecoderConfig = DecoderConfig()
    loss: FieldLossConfig = FieldLossConfig()
    schedule: Schedule = Schedule(epochs=20_000, batch_size=4096)
    optimizer: FieldOptimizerConfig = FieldOptimizerConfig()
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        if self.latents.layout == "local":
            # Knots lie at normalised coordinates; a path rotates positions, whose x and z need the same scale.
            settings = self.encoder.coordinates, self.pose_vectors, self.loss.scaling
            if settings != ("normalised", "field", "group"):
                raise ValueError(
                    "latents.layout=local needs encoder.coordinates=normalised, pose_vectors=field and "
                    f"loss.scaling=group, not {', '.join(settings)}: use latents.layout=global"
                )


@dataclass(frozen=True)
class TransformerConfig:
    """Sizes of the denoiser.

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


@dataclass(frozen=True)
class DenoiserConfig:
    """The stage `denoiser` (paper §3.2, D).

    With local latents `variations` of each training window are encoded and learnt from beside it (ours): begun earlier
    or later, mirrored or not, faster or slower. With `balanced` each caption (or action) is drawn equally often (ours).
    `ema_decay` is the decay of the weights' moving average (0: none).
    """

    network: TransformerConfig = TransformerConfig()
    diffusion: DiffusionConfig = DiffusionConfig()
    conditions: ConditionsConfig = ConditionsConfig()
    schedule: Schedule = Schedule(epochs=3000)
    variations: int = 0
    balanced: bool = False
    ema_decay: float = 0.0
    precision: Precision = "float32"


@dataclass(frozen=True)
class NermConfig:
    """All stages of NeRM."""

    codebook: CodebookConfig = CodebookConfig()
    field: FieldConfig = FieldConfig()
    denoiser: DenoiserConfig = DenoiserConfig()


def paper() -> NermConfig:
    """The paper's settings (§3, B.1, D) and its 263 numbers; where it is silent, those of docs/deviations.md.

    Its action task (§4.2, A) needs field.pose_vectors=rotations and denoiser.conditions.text_encoder=none too.
    """
    return NermConfig(
        field=FieldConfig(pose_vectors="native"),
        denoiser=DenoiserConfig(conditions=ConditionsConfig(text_encoder="clip")),
    )


def nano() -> NermConfig:
    """Minutes on two CPU cores: smaller networks, local latents, the settings measured in docs/results."""
    # At full learning rate the field's first steps undo the linear initialisation; recovering it takes a hundred.
    return NermConfig(
        _changed(
            CodebookConfig(),
            "network.width=128 network.num_codes=256 schedule.steps=600 schedule.batch_size=48 "
            "schedule.learning_rate=1e-3 schedule.drop_every=0.8",
        ),
        _changed(
            FieldConfig(),
            "windows.stride_seconds=2 clips.num_poses=8 clips.contiguous=false clips.seconds_per_visit=2.5 "
            "clips.warmup_fraction=0.02 clips.lowest_fps=20 latents.layout=local latents.initial_log_variance=-8 "
            "encoder.num_queries=64 encoder.framerate_scale=0.05 decoder.width=256 decoder.activation=silu "
            "loss.scaling=group loss.root_weight=4 precision=auto "
            "schedule.epochs=none schedule.steps=8000 schedule.batch_size=256 schedule.learning_rate=8e-3 "
            "schedule.kind=cosine schedule.warmup_fraction=0.05 optimizer.attention_learning_rate=1e-3 "
            "optimizer.latent_learning_rate=1e-2 optimizer.weight_decay=0",
        ),
        _changed(
            DenoiserConfig(),
            "network.num_layers=5 network.width=192 network.ffn_width=512 network.dropout=0 network.latent_tokens=8 "
            "diffusion.prediction=velocity diffusion.sampling_steps=10 diffusion.guidance_scale=2 "
            "conditions.paraphrases=12 variations=4 balanced=true schedule.epochs=none schedule.steps=8000 "
            "schedule.learning_rate=2e-3 schedule.kind=cosine schedule.warmup_fraction=0.02 ema_decay=0.995 "
            "precision=auto",
        ),
    )


def small() -> NermConfig:
    """Half an hour on one CPU core: `nano` with mirrored windows and twice the steps of the field."""
    return _changed(nano(), "field.windows.mirrored=true field.schedule.steps=16000")


def base() -> NermConfig:
    """An hour on an H100: `nano` at the paper's widths; docs/howto/seed.md counts the FLOPs."""
    return _changed(
        replace(nano(), codebook=CodebookConfig()),
        "codebook.schedule.steps=20000 codebook.schedule.drop_every=0.65 codebook.precision=auto "
        "field.windows.mirrored=true field.encoder.num_queries=256 field.decoder.width=1024 "
        "field.schedule.steps=60000 field.schedule.batch_size=4096 field.schedule.learning_rate=2e-3 "
        "field.optimizer.attention_learning_rate=5e-4 denoiser.network.num_layers=9 denoiser.network.width=512 "
        "denoiser.network.num_heads=8 denoiser.network.ffn_width=2048 denoiser.network.dropout=0.1 "
        "denoiser.network.latent_tokens=16 denoiser.schedule.steps=80000 denoiser.schedule.batch_size=256 "
        "denoiser.schedule.learning_rate=3e-4 denoiser.ema_decay=0.9999",
    )


def demo() -> NermConfig:
    """For the embedded corpus, minutes: `nano` with a smaller codebook, sparser windows and fewer steps."""
    return _changed(
        nano(),
        "codebook.network.width=64 codebook.network.num_codes=128 codebook.schedule.steps=120 "
        f"codebook.schedule.batch_size=32 codebook.schedule.drop_every={100 / 120} field.windows.stride_seconds=5 "
        "field.schedule.steps=1200 denoiser.schedule.steps=1000 "
        "denoiser.conditions.paraphrases=0 denoiser.variations=0",
    )


def _changed(config: ConfigT, settings: str) -> ConfigT:
    return apply_overrides(config, settings.split())


RECIPES: dict[str, Callable[[], NermConfig]] = {each.__name__: each for each in (nano, small, demo, base, paper)}


CODEBOOK = Stage(
    "codebook",
    "VQ-VAE codebook of poses at 20 fps (NeRM's prior for coordinates)",
    RECIPES,
    lazily("nerm.codebook:train_codebook"),
    check=lazily("nerm.codebook:check_codebook"),
    share=0.1,
    shared=True,
)
FIELD = Stage(
    "field",
    "variational implicit motion field with one latent per window (NeRM, stage 1)",
    RECIPES,
    lazily("nerm.field_training:train_field"),
    check=lazily("nerm.field_training:check_field"),
    share=0.5,
    shared=True,
    builds_on=lambda config: ("codebook",) if config.field.encoder.kind == "codebook" else (),
    packed=lazily("nerm.model:without_training_windows"),
)
DENOISER = Stage(
    "denoiser",
    "latent diffusion conditioned on a text, an action or nothing (NeRM, stage 2)",
    RECIPES,
    lazily("nerm.denoiser:train_denoiser"),
    check=lazily("nerm.denoiser:check_denoiser"),
    share=0.4,
    shared=True,
    builds_on=lambda config: ("field",),
)


LOCAL = "NeRM, local latents (ours)"
PUBLISHED = "NeRM as published"
LAYERS = "NeRM, published layers, other training"
OTHERWISE = "NeRM, global latent (our settings)"

# The paper leaves open the data; NeRM-fixed is in the paper.
_OPEN = ("where", "pose_vectors", "windows.", "clips.fixed_fps", "conditions.", "published_weights")
_TRAINING = {"schedule.steps", "schedule.epochs", "schedule.batch_size", "precision"}


def row_name(run: RunFolder, field: FieldConfig, denoiser: DenoiserConfig | None = None) -> str:
    """The name of a run's row in tables: "as published" only if all that the paper states is the paper's."""
    if field.latents.layout == "local":
        return LOCAL
    different = _differences(field, FieldConfig())
    encoder = "none" if denoiser is None else denoiser.conditions.text_encoder
    if denoiser is not None:
        different |= _differences(denoiser, DenoiserConfig())
    if field.pose_vectors == "field" or different - _TRAINING:
        return OTHERWISE
    stages = {name: run.stage(name) for name in ("codebook", "field", "denoiser")}
    recorded = {name: stage.read_config() for name, stage in stages.items() if stage.is_complete}
    if "codebook" not in recorded or encoder not in ("clip", "none"):
        return LAYERS
    codebook = from_plain(CodebookConfig, recorded["codebook"]["config"]["codebook"])
    different |= set() if codebook.published_weights else _differences(codebook, CodebookConfig())
    has_budget = any(recorded[name].get("budget_seconds") is not None for name in recorded.keys() - {"codebook"})
    return LAYERS if different or has_budget else PUBLISHED


def _differences(config: ConfigLike, paper: ConfigLike) -> set[str]:
    theirs = flatten(paper)
    return {key for key, value in flatten(config).items() if not key.startswith(_OPEN) and value != theirs[key]}


# Ablations: the paper's Tables 5 to 9, and ours. A variant is one training run, which tables share, so the paper's full
# model is trained once for all. The paper's tables use its own layout of z, `global`; rows of our layout, `local`, are
# added where they apply.


def _rows(layout: LatentLayout, *changes: tuple[str, ...]) -> tuple[Variant, ...]:
    """Rows of a layout: a label; for a run that differs from the recipe in that layout also its name, and a setting."""
    settings = [f"field.latents.layout={layout}"]
    if layout == "global":
        settings += ["field.optimizer.latent_learning_rate=1e-1", "denoiser.network.latent_tokens=1"]
    else:
        settings += ["field.pose_vectors=field", "field.loss.scaling=group"]

    def needs(recipe: NermConfig) -> tuple[str, ...]:
        """Settings for a recipe made for the other layout."""
        return () if recipe.field.latents.layout == layout else tuple(settings)

    return tuple(
        Variant("-".join((layout, *name[:1])), tuple(name[1:]), f"{layout}: {label}", needs=needs)
        for label, *name in changes
    )


_BOTH = ("field", "denoiser")
_NO_TIME = ("no coordinate at all", "no-time", "field.encoder.kind=none")
_RAW_TIME = ("the coordinate itself", "raw-time", "field.encoder.kind=raw")
_FOURIER = ("Fourier features", "fourier", "field.encoder.kind=fourier")
_CODEBOOK = ("Fourier features and codebook",)
_POINT = ("one z a window, no distribution (Eq. 9)", "non-variational", "field.latents.variational=false")
_VARIATIONAL = ("variational",)
_SIZES = (
    ("d = 128", "d-128", "field.latents.dimension=128"),
    ("d = 256",),
    ("d = 512", "d-512", "field.latents.dimension=512"),
    ("λ_KL = 1e-5", "kl-1e-5", "field.loss.kl_weight=1e-5"),
    ("λ_KL = 1e-4",),
    ("λ_KL = 1e-3", "kl-1e-3", "field.loss.kl_weight=1e-3"),
)
# Knots lie at normalised coordinates, so Table 9 has no rows of the local layout.
_FRAME_NUMBERS = ("frame numbers 1 … T", "frame-numbers", "field.encoder.coordinates=frames")
_FRAMERATES = (
    ("as the recipe",),
    ("no warm-up at one framerate", "warmup-0", "field.clips.warmup_fraction=0"),
    ("half of the steps at 20 fps", "warmup-50", "field.clips.warmup_fraction=0.5"),
    ("all steps at 20 fps (NeRM-fixed)", "fixed-20", "field.clips.fixed_fps=20"),
)
_TIMES = _rows("global", _NO_TIME, _RAW_TIME, _FOURIER, _CODEBOOK) + _rows("local", _NO_TIME, _FOURIER, _CODEBOOK)
_LATENTS = _rows("global", _POINT, _VARIATIONAL) + _rows("local", _POINT, _VARIATIONAL)
_DECODERS = _rows("global", ("transformer", "transformer", "field.decoder.kind=transformer"), ("MLP",))
_LAYOUTS = _rows("global", *_FRAMERATES) + _rows("local", *_FRAMERATES)
_TABLES = (
    Ablation("5", "time encoding", _TIMES, _BOTH),
    Ablation("6", "variational latents", _LATENTS, _BOTH),
    Ablation("7", "decoder", _DECODERS, _BOTH),
    Ablation("8", "size of z and weight of the KL term", _rows("global", *_SIZES), ("field",)),
    Ablation("9", "time normalisation", _rows("global", _FRAME_NUMBERS, ("normalised to [−1, 1]",)), _BOTH),
    Ablation("ours", "layout of z, and framerates in training", _LAYOUTS, _BOTH),
)


def share_codebook(common: StageContext, run: RunFolder, config: NermConfig) -> None:
    """Give a run the codebook of the common run, trained first if it is missing; a variant without codes gets none."""
    from motionkit.store.commit import read_manifest  # deferred: networks read settings without a store

    if config.field.encoder.kind != "codebook":
        return
    source, target = common.run.stage(CODEBOOK.name), run.stage(CODEBOOK.name)
    with source.locked():
        if source.is_complete:
            CODEBOOK.check_kept(common, config, read_manifest(common.store).fingerprint)
        else:
            CODEBOOK.train(common, config)
    if target.is_complete and target.model_path.read_bytes() == source.model_path.read_bytes():
        return
    with target.locked():
        clear_stage(target)
        for path in source.result_paths:  # The last one marks the stage as complete.
            if path.is_file():
                write_whole(target.path / path.name, path.read_bytes())


NERM = Ablations(
    "nerm",
    {ablation.table: ablation for ablation in _TABLES},
    {"field": FIELD, "denoiser": DENOISER},
    share_codebook,
    is_default=True,
)
