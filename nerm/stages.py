"""NeRM's first stage as a trainable stage, registered under `motionkit.stages`."""

from motionkit.training.stage import Stage, StageContext
from nerm.recipes import RECIPES, NermConfig


def _train_field(context: StageContext, config: NermConfig) -> None:
    from nerm.field_stage import train_field

    train_field(context, config)


FIELD = Stage(
    name="field",
    order=20,
    description="variational implicit motion field with one latent per window (NeRM, stage 1)",
    recipes=RECIPES,
    train=_train_field,
)
