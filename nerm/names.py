"""Names of NeRM's rows in tables: by its training settings, not by the recipe's name."""

from motionkit.training.config import ConfigLike, flatten
from nerm.settings import DenoiserConfig, FieldConfig

LOCAL = "NeRM, local latents (ours)"
PUBLISHED = "NeRM as published"
OTHERWISE = "NeRM, global latent (our settings)"

# Settings that the paper leaves open: data, text encoder, duration of the training, machine. NeRM-fixed is in the
# paper.
_FREE = (
    *("where", "pose_vectors", "windows.", "clips.fixed_fps", "conditions.text_", "conditions.action_share"),
    *("schedule.steps", "schedule.epochs", "schedule.batch_size", "precision", "compile"),
)


def row_name(field: FieldConfig, denoiser: DenoiserConfig | None = None) -> str:
    """The name of a row; "as published" if every setting that the paper determines is the paper's."""
    if field.latents.layout == "local":
        return LOCAL
    published = field.pose_vectors in ("native", "rotations") and _differs_freely(field, FieldConfig())
    if denoiser is not None:
        published = published and _differs_freely(denoiser, DenoiserConfig())
    return PUBLISHED if published else OTHERWISE


def _differs_freely(config: ConfigLike, paper: ConfigLike) -> bool:
    theirs = flatten(paper)
    return all(key.startswith(_FREE) or value == theirs[key] for key, value in flatten(config).items())
