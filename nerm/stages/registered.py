"""NeRM's stages as trainable stages, registered under `motionkit.stages`."""

from motionkit.training.stage import Stage, StageContext
from nerm.recipes import RECIPES, NermConfig


def _train_codebook(context: StageContext, config: NermConfig) -> None:
    from nerm.stages.codebook import train_codebook

    train_codebook(context, config)


def _check_codebook(context: StageContext, config: NermConfig) -> None:
    from nerm.stages.codebook import check_codebook

    check_codebook(context, config)


def _train_field(context: StageContext, config: NermConfig) -> None:
    from nerm.stages.field import train_field

    train_field(context, config)


def _check_field(context: StageContext, config: NermConfig) -> None:
    from nerm.stages.field import check_field

    check_field(context, config)


def _train_denoiser(context: StageContext, config: NermConfig) -> None:
    from nerm.stages.denoiser import train_denoiser

    train_denoiser(context, config)


def _check_denoiser(context: StageContext, config: NermConfig) -> None:
    from nerm.stages.denoiser import check_denoiser

    check_denoiser(context, config)


def _codebook_where_used(config: NermConfig) -> tuple[str, ...]:
    return ("codebook",) if config.field.encoder.kind == "codebook" else ()


def _field(config: NermConfig) -> tuple[str, ...]:
    return ("field",)


CODEBOOK = Stage(
    name="codebook",
    order=10,
    description="VQ-VAE codebook of poses at 20 fps (NeRM's prior for coordinates)",
    recipes=RECIPES,
    train=_train_codebook,
    check=_check_codebook,
    shared=True,
)
FIELD = Stage(
    name="field",
    order=20,
    description="variational implicit motion field with one latent per window (NeRM, stage 1)",
    recipes=RECIPES,
    train=_train_field,
    check=_check_field,
    shared=True,
    builds_on=_codebook_where_used,
)
DENOISER = Stage(
    name="denoiser",
    order=30,
    description="latent diffusion under a text, an action or no condition (NeRM, stage 2)",
    recipes=RECIPES,
    train=_train_denoiser,
    check=_check_denoiser,
    shared=True,
    builds_on=_field,
)
