"""NeRM's trainable stages."""

from motionkit.core.plugins import lazily
from motionkit.training.run import Stage
from nerm.recipes import RECIPES, NermConfig


def _codebook_where_used(config: NermConfig) -> tuple[str, ...]:
    return ("codebook",) if config.field.encoder.kind == "codebook" else ()


def _field(config: NermConfig) -> tuple[str, ...]:
    return ("field",)


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
    builds_on=_codebook_where_used,
)
DENOISER = Stage(
    "denoiser",
    "latent diffusion conditioned on a text, an action or nothing (NeRM, stage 2)",
    RECIPES,
    lazily("nerm.denoiser:train_denoiser"),
    check=lazily("nerm.denoiser:check_denoiser"),
    share=0.4,
    shared=True,
    builds_on=_field,
)
