"""A trained field as it rests in a run folder: model.safetensors, written and read back."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from motionkit.clips.windows import Windows
from motionkit.training.config import from_plain, to_plain
from motionkit.training.device import resolve_device
from motionkit.training.run import RunFolder, StageFolder
from motionkit.training.tensors import CheckpointError, load_tensors, prefixed, rebuilding, save_tensors, unprefixed
from nerm.field.network import FieldNetwork
from nerm.field.trained import TrainedField
from nerm.latents.linear_fit import PoseComponents
from nerm.pose_vectors.choice import described, restored
from nerm.pose_vectors.scaling import VectorScaling
from nerm.settings.field import FieldConfig

STAGE_NAME = "field"
FORMAT_VERSION = 2


def save_field(folder: StageFolder, trained: TrainedField) -> None:
    """Write model.safetensors: network, scales, posteriors and the window table, with the settings in its header."""
    tensors = (
        prefixed("network", trained.network.state_dict())
        | prefixed("scaling", {"mean": trained.scaling.mean, "scale": trained.scaling.scale})
        | prefixed("posterior", {"mean": trained.posterior_mean, "log_variance": trained.posterior_log_variance})
        | described(trained.vectors)
        | prefixed("windows", {name: torch.from_numpy(array) for name, array in trained.windows.arrays().items()})
    )
    if trained.components is not None:
        tensors["components.mean"] = trained.components.mean
        tensors["components.directions"] = trained.components.directions
    description: dict[str, Any] = {
        "format": "nerm-field",
        "version": FORMAT_VERSION,
        "config": to_plain(trained.config),
        "layout": trained.skeleton.name,
        "store_fingerprint": trained.store_fingerprint,
    }
    save_tensors(folder.model_path, tensors, description)


def load_field(run: RunFolder | Path, device: str = "cpu") -> TrainedField:
    """Load a run's trained field; raises `CheckpointError` where there is none or it is of another format."""
    folder = (run if isinstance(run, RunFolder) else RunFolder(run)).stage(STAGE_NAME)
    if not folder.model_path.is_file():
        folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    if description.get("format") != "nerm-field" or description.get("version") != FORMAT_VERSION:
        raise CheckpointError(
            f"{folder.model_path} is {description.get('format')!r} version {description.get('version')}, expected "
            f"'nerm-field' version {FORMAT_VERSION}: train it again (motionkit train --stage field --overwrite)"
        )
    where = resolve_device(device)
    with rebuilding(folder.model_path, STAGE_NAME, tensors):
        return _rebuild(tensors, description, where)


def _rebuild(tensors: Mapping[str, torch.Tensor], description: Mapping[str, Any], where: torch.device) -> TrainedField:
    config = from_plain(FieldConfig, description["config"])
    scaling = VectorScaling(tensors["scaling.mean"], tensors["scaling.scale"])
    network = FieldNetwork(config, len(scaling.mean), tensors.get("network.attention.codebook"))
    network.load_state_dict(unprefixed("network", tensors))
    arrays = {name: tensor.numpy() for name, tensor in unprefixed("windows", tensors).items()}
    components = None
    if config.latent_layout == "local":
        components = PoseComponents(tensors["components.mean"], tensors["components.directions"])
    return TrainedField(
        network=network.to(where).eval().requires_grad_(False),
        scaling=scaling.to(where),
        components=components,
        posterior_mean=tensors["posterior.mean"],
        posterior_log_variance=tensors["posterior.log_variance"],
        windows=Windows(config.max_duration_seconds, **arrays),
        store_fingerprint=str(description["store_fingerprint"]),
        vectors=restored(config.pose_vectors, tensors),
    )
