"""A trained denoiser as it rests in a run folder: model.safetensors, written and read back."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from motionkit.training.config import from_plain, to_plain
from motionkit.training.randomness import seeded_initialisation
from motionkit.training.run import RunFolder
from motionkit.training.tensors import load_tensors, prefixed, rebuilding, save_tensors, unprefixed
from nerm.conditions.batch import ConditionLayout
from nerm.denoiser.latent_space import LatentSpace
from nerm.denoiser.network import Denoiser
from nerm.denoiser.trained import TrainedDenoiser
from nerm.latents.local import LocalLatents
from nerm.settings.denoiser import DenoiserConfig

STAGE_NAME = "denoiser"


def save_denoiser(run: RunFolder, trained: TrainedDenoiser) -> None:
    """Write RUN/denoiser/model.safetensors."""
    tensors = prefixed("denoiser", trained.denoiser.state_dict()) | {
        "latent_mean": trained.space.mean,
        "latent_deviation": trained.space.deviation,
        "durations": trained.durations,
    }
    description = {
        "config": to_plain(trained.config),
        "banks": None if trained.space.banks is None else to_plain(trained.space.banks),
        "text_dimension": trained.layout.text_dimension,
        "actions": list(trained.layout.actions),
        "text_encoder": trained.text_encoder,
        "text_fingerprint": trained.text_fingerprint,
        "field_sha256": trained.field_sha256,
    }
    save_tensors(run.stage(STAGE_NAME).model_path, tensors, description)


def load_denoiser(run: RunFolder, device: torch.device | None = None) -> TrainedDenoiser:
    """Read RUN/denoiser/model.safetensors; the network goes to `device` (default: the CPU).

    Raises `RunError` where the stage was not trained to its end, `CheckpointError` for a damaged file.
    """
    folder = run.stage(STAGE_NAME)
    folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    with rebuilding(folder.model_path, STAGE_NAME, tensors):
        trained = _rebuild(tensors, description)
    if device is not None:
        trained.denoiser.to(device)
    return trained


def _rebuild(tensors: Mapping[str, Tensor], description: Mapping[str, Any]) -> TrainedDenoiser:
    config = from_plain(DenoiserConfig, description["config"])
    layout = ConditionLayout(int(description["text_dimension"]), tuple(description["actions"]))
    banks = None if description["banks"] is None else from_plain(LocalLatents, description["banks"])
    space = LatentSpace(banks, config.path, tensors["latent_mean"], tensors["latent_deviation"])
    with seeded_initialisation(0, STAGE_NAME):
        denoiser = Denoiser(config.network, tensors["denoiser.first_read"], layout)
    denoiser.load_state_dict(unprefixed("denoiser", tensors))
    return TrainedDenoiser(
        config=config,
        denoiser=denoiser.eval().requires_grad_(False),
        space=space,
        layout=layout,
        durations=tensors["durations"],
        text_encoder=str(description["text_encoder"]),
        text_fingerprint=str(description["text_fingerprint"]),
        field_sha256=str(description["field_sha256"]),
    )
