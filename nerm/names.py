"""What rows of NeRM are called in tables: by the settings that it was trained with, not by the recipe's name."""

from motionkit.training.config import ConfigLike, flatten
from nerm.settings import DenoiserConfig, FieldConfig

LOCAL = "NeRM, local latents (ours)"
PUBLISHED = "NeRM as published"
OTHERWISE = "NeRM, global latent (our settings)"

# What the paper leaves to whoever trains: the data, the texts' encoder, how long, on what machine. NeRM-fixed is the
# paper's own.
_FREE = (
    *("where", "pose_vectors", "windows.", "clips.fixed_fps", "conditions.text_", "conditions.action_share"),
    *("schedule.steps", "schedule.epochs", "schedule.batch_size", "precision", "compile"),
)


def row_name(field: FieldConfig, denoiser: DenoiserConfig | None = None) -> str:
    """The name of a row; "as published" where every setting that the paper has or that is decided for it is its own."""
    if field.latents.layout == "local":
        return LOCAL
    published = field.pose_vectors in ("native", "rotations") and _differs_freely(field, FieldConfig())
    if denoiser is not None:
        published = published and _differs_freely(denoiser, DenoiserConfig())
    return PUBLISHED if published else OTHERWISE


def _differs_freely(config: ConfigLike, paper: ConfigLike) -> bool:
    theirs = flatten(paper)
    return all(key.startswith(_FREE) or value == theirs[key] for key, value in flatten(config).items())
