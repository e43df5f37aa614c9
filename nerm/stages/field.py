"""Stage `field`: from a store to a trained field with the posteriors of all windows."""

import dataclasses
import time

import torch

from motionkit.core.progress import warn
from motionkit.core.shapes import Float32
from motionkit.data.corpus import FrameValues, open_frames, training_vectors
from motionkit.data.poses import WindowPoses
from motionkit.features.convention import PoseVectors
from motionkit.store.cache import PositionCache
from motionkit.store.reader import Store
from motionkit.training.devices import float32_products, resolve_device, with_precision_of
from motionkit.training.loop import train_loop
from motionkit.training.run import RunError
from motionkit.training.stage import StageContext
from nerm.codebook.network import load_codes
from nerm.denoiser.latent_space import measured_space
from nerm.field.contact import ContactTraining, contact_rows
from nerm.field.trained import TrainedField, save_field
from nerm.field.training import FieldTraining, remarks, training_windows
from nerm.latents.posterior import first_read, in_use
from nerm.recipes import NermConfig
from nerm.settings import FieldConfig


def train_field(context: StageContext, config: NermConfig) -> None:
    """Train f_θ and the posteriors of all windows; write both, with the window table, to model.safetensors."""
    store, device, ranks = context.open_store(), resolve_device(context.device), context.ranks
    settings = with_precision_of(config.field, device)
    config = dataclasses.replace(config, field=settings)
    started = time.perf_counter()
    # All checks come before `begin`, which may remove an earlier run (--overwrite).
    vectors, source, frames = _corpus(store, settings)
    windows = training_windows(source, settings)
    codes = _codes(context, settings)
    builds_on = () if codes is None else ("codebook",)
    folder = context.begin("field", config, store_fingerprint=store.fingerprint, builds_on=builds_on)
    for remark in remarks(source, windows, settings) if ranks.is_first else []:
        warn(remark)
    training = FieldTraining(
        WindowPoses(windows, frames, settings.clips.fixed_framerate),
        settings,
        codebook=codes,
        seed=context.seed,
        device=device,
        ranks=ranks,
    )
    with float32_products(settings.precision):
        context.fit_budget(training, folder)
        figures = train_loop(
            training, folder, steps=training.steps, seed=context.seed, ranks=ranks, on_progress=context.on_progress
        )
    mean, log_variance = training.posteriors()
    if not ranks.is_first:
        return
    trained = TrainedField(
        network=training.network.eval().requires_grad_(False),
        scaling=training.scaling,
        components=training.components,
        posterior_mean=mean,
        posterior_log_variance=log_variance,
        windows=windows,
        store_fingerprint=store.fingerprint,
        vectors=vectors,
    )
    if settings.contacts.steps and trained.network.local is not None:
        trained, figures["contacts"] = _with_contacts(trained, source, context)
    save_field(folder, trained)
    hours = float(windows.duration_seconds.sum()) / 3600
    facts = {"windows": len(windows), "hours": round(hours, 3), "wall_seconds": round(time.perf_counter() - started, 1)}
    facts["parameters"] = sum(parameter.numel() for parameter in training.network.parameters())
    folder.finish({**figures, **facts})


def _with_contacts(trained: TrainedField, source: PositionCache, context: StageContext) -> tuple[TrainedField, float]:
    """The field with a trained contact head, and the head's final loss."""
    banks = trained.network.local
    means, duration = trained.posterior_mean, trained.windows.duration_seconds / trained.max_duration_seconds
    used = in_use(first_read(means.shape[1], banks), torch.from_numpy(duration).float())
    space = measured_space(means, used, banks, "steps", "component")
    most = trained.config.contacts.noise

    def noisy(latents: Float32[torch.Tensor, "batch latent"], generator: torch.Generator) -> torch.Tensor:
        share = torch.rand(len(latents), 1, generator=generator)
        noise = torch.randn(latents.shape, generator=generator)
        return space.restore(space.standardise(latents) + most * share * noise)

    rows, network = contact_rows(source), trained.network
    training = ContactTraining(network, means, trained.windows, rows, noisy, seed=context.seed)
    loss = training.run(context.on_progress)
    return dataclasses.replace(trained, contacts=training.head.eval().requires_grad_(False)), loss


def check_field(context: StageContext, config: NermConfig) -> None:
    """Raise early what would stop this stage: no sequence to cut windows from."""
    _, source, _ = _corpus(context.open_store(), config.field)
    training_windows(source, config.field)


def _corpus(store: Store, settings: FieldConfig) -> tuple[PoseVectors, PositionCache, FrameValues]:
    where = settings.where or None
    vectors = training_vectors(settings.pose_vectors, store, where)
    return vectors, *open_frames(vectors, store, where)


def _codes(context: StageContext, settings: FieldConfig) -> Float32[torch.Tensor, "codes dimension"] | None:
    if settings.encoder.kind != "codebook":
        return None
    if not context.run.stage("codebook").is_complete:
        raise RunError(
            f"the time encoding 'codebook' needs the stage codebook of {context.run.path}: train it first "
            f"(motionkit train --stage codebook), or use --set field.encoder.kind=fourier"
        )
    return load_codes(context.run)
