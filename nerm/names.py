"""Names of NeRM's rows in tables: by how its stages were trained, not by the recipe's name."""

from motionkit.training.config import ConfigLike, flatten
from motionkit.training.run import RunFolder
from nerm.settings import CodebookConfig, DenoiserConfig, FieldConfig, from_recorded

LOCAL = "NeRM, local latents (ours)"
PUBLISHED = "NeRM as published"
LAYERS = "NeRM, published layers, other training"
OTHERWISE = "NeRM, global latent (our settings)"

# The paper leaves open the data; NeRM-fixed is in the paper.
_OPEN = ("where", "pose_vectors", "windows.", "clips.fixed_fps", "conditions.", "published.")
_TRAINING = {"schedule.steps", "schedule.epochs", "schedule.batch_size", "precision"}


def row_name(run: RunFolder, field: FieldConfig, denoiser: DenoiserConfig | None = None) -> str:
    """The name of a row: "as published" only if all that the paper states is the paper's."""
    if field.latents.layout == "local":
        return LOCAL
    different = _differences(field, FieldConfig())
    encoder = "none" if denoiser is None else denoiser.conditions.text_encoder
    if denoiser is not None:
        different |= _differences(denoiser, DenoiserConfig())
    if field.pose_vectors == "field" or different - _TRAINING:
        return OTHERWISE
    trained = [run.stage(name) for name in ("field", "denoiser") if run.stage(name).is_complete]
    has_budget = any(stage.read_config().get("budget_seconds") is not None for stage in trained)
    published = not different and not has_budget and encoder in ("clip", "none") and _has_published_codebook(run)
    return PUBLISHED if published else LAYERS


def _differences(config: ConfigLike, paper: ConfigLike) -> set[str]:
    theirs = flatten(paper)
    return {key for key, value in flatten(config).items() if not key.startswith(_OPEN) and value != theirs[key]}


def _has_published_codebook(run: RunFolder) -> bool:
    """Whether a run's codebook is T2M-GPT's own, or trained with its settings."""
    stage = run.stage("codebook")
    if not stage.is_complete:
        return False
    codebook = from_recorded(CodebookConfig, stage.read_config()["config"]["codebook"])
    return bool(codebook.published.weights) or not _differences(codebook, CodebookConfig())
