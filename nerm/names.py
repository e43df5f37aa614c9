"""Names of NeRM's rows in tables: by how its stages were trained, not by the recipe's name."""

from typing import Any

from motionkit.training.config import ConfigLike, flatten
from motionkit.training.run import RunFolder, StageFolder
from nerm.settings import CodebookConfig, DenoiserConfig, FieldConfig, from_recorded

LOCAL = "NeRM, local latents (ours)"
PUBLISHED = "NeRM as published"
LAYERS = "NeRM, published layers"
OTHERWISE = "NeRM, global latent (our settings)"

# Settings that are neither layers nor losses. The paper leaves open the data and the machine; what it says of the
# others is compared in `_differences`. NeRM-fixed is in the paper.
_OUTSIDE = (
    *("where", "pose_vectors", "windows.", "clips.fixed_fps", "conditions.text_", "conditions.action_share"),
    *("schedule.steps", "schedule.epochs", "schedule.batch_size", "precision", "compile", "published."),
)
# Relative difference of a training's length that still counts as the paper's.
TOLERANCE = 0.01


def row_name(run: RunFolder, field: FieldConfig, denoiser: DenoiserConfig | None = None) -> str:
    """The name of a row: "as published" only if all that the paper states is the paper's.

    With the paper's layers and losses but another training, text encoder or codebook, the name says what differs.
    """
    if field.latents.layout == "local":
        return LOCAL
    published = field.pose_vectors in ("native", "rotations") and _has_same_layers(field, FieldConfig())
    if denoiser is not None:
        published = published and _has_same_layers(denoiser, DenoiserConfig())
    if not published:
        return OTHERWISE
    differences = [
        *_training_differences(run.stage("field"), field, FieldConfig()),
        *_codebook_differences(run.stage("codebook")),
    ]
    if denoiser is not None:
        differences += _training_differences(run.stage("denoiser"), denoiser, DenoiserConfig())
        if (encoder := denoiser.conditions.text_encoder) not in ("clip", "none"):
            differences.append(f"texts by {encoder}")
    return ", ".join([LAYERS, *dict.fromkeys(differences)]) if differences else PUBLISHED


def _has_same_layers(config: ConfigLike, paper: ConfigLike) -> bool:
    theirs = flatten(paper)
    return all(key.startswith(_OUTSIDE) or value == theirs[key] for key, value in flatten(config).items())


def _training_differences(
    stage: StageFolder, config: FieldConfig | DenoiserConfig, paper: FieldConfig | DenoiserConfig
) -> list[str]:
    """What differs in the number of epochs (from the steps that were made), the batch size and the precision."""
    summary, batch = _summary(stage), config.schedule.batch_size
    epochs = summary.get("steps", summary.get("step", 0)) * batch / summary.get("windows", 1)
    assert paper.schedule.epochs is not None
    found = []
    if abs(epochs / paper.schedule.epochs - 1.0) > TOLERANCE:
        found.append("short training" if epochs < paper.schedule.epochs else "long training")
    if batch != paper.schedule.batch_size:
        found.append(f"{stage.path.name} batches of {batch}")
    if config.precision != paper.precision:
        found.append(config.precision)
    return found


def _codebook_differences(stage: StageFolder) -> list[str]:
    summary = _summary(stage)
    if "from" in summary:
        return []  # T2M-GPT's own weights, as in the paper
    if not summary:
        return ["unknown codebook"]
    paper, codebook = CodebookConfig(), from_recorded(CodebookConfig, stage.read_config()["config"]["codebook"])
    sizes, paper_sizes = ((each.network.num_codes, each.network.code_dimension) for each in (codebook, paper))
    if sizes != paper_sizes:
        return [f"codebook {sizes[0]} × {sizes[1]}"]
    windows = summary.get("step", 0) * codebook.schedule.batch_size
    same_length = abs(windows / (paper.schedule.steps * paper.schedule.batch_size) - 1.0) <= TOLERANCE
    return [] if same_length and _has_same_layers(codebook, paper) else ["another codebook training"]


def _summary(stage: StageFolder) -> dict[str, Any]:
    return stage.read_summary() if stage.is_complete else {}
