"""Stage `denoiser`: from a run's field and the store it was trained on to a trained latent diffusion."""

import dataclasses
import time

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import sha256_of
from motionkit.training.devices import float32_products, resolve_device, with_precision_of
from motionkit.training.loop import train_loop
from motionkit.training.run import RunError
from motionkit.training.stage import StageContext
from motionkit.training.text import TextEncoder, load_text_encoder
from nerm.denoiser.corpus import corpus_of
from nerm.denoiser.trained import STAGE_NAME, save_denoiser
from nerm.denoiser.training import DenoiserTraining
from nerm.field.trained import load_field
from nerm.latents.local import local_latents
from nerm.recipes import NermConfig
from nerm.settings import DenoiserConfig


def train_denoiser(context: StageContext, config: NermConfig) -> None:
    """Train ε_φ on the latents of RUN/field; write the denoiser and what sampling needs to model.safetensors.

    Raises `RunError` if the field is missing or was trained on another state of the store (captions are looked up in
    the store by its windows' sequences), and `UsageError` if it needs texts and no window has any.
    """
    store, device, ranks = context.open_store(), resolve_device(context.device), context.ranks
    settings = with_precision_of(config.denoiser, device)
    config = dataclasses.replace(config, denoiser=settings)
    field = load_field(context.run)
    if field.store_fingerprint != store.fingerprint:
        raise RunError(
            f"the field of {context.run.path} was trained on a store of fingerprint {field.store_fingerprint[:16]}, "
            f"{context.store} has {store.fingerprint[:16]}: train the field again, or give --store"
        )
    started = time.perf_counter()
    encoder = _encoder(settings)
    corpus = corpus_of(
        field.posterior_mean,
        field.posterior_log_variance,
        field.windows,
        store,
        encoder,
        local_latents(field.config),
        settings.conditions.paraphrases,
        context.seed,
    )
    if encoder is not None and not corpus.num_captions.any():
        raise _without_captions(f"none of the field's {len(corpus)} training windows", settings)
    folder = context.begin(STAGE_NAME, config, store_fingerprint=store.fingerprint, builds_on=("field",))
    training = DenoiserTraining(settings, corpus, seed=context.seed, device=device, ranks=ranks)
    with float32_products(settings.precision):
        context.fit_budget(training, folder)
        figures = train_loop(
            training, folder, steps=training.steps, seed=context.seed, ranks=ranks, on_progress=context.on_progress
        )
    if not ranks.is_first:
        return
    trained = training.finished(
        text_fingerprint="" if encoder is None else encoder.fingerprint,
        field_sha256=sha256_of(context.run.stage("field").model_path),
    )
    save_denoiser(context.run, trained)
    folder.finish(
        {
            "loss": figures["loss"],
            "steps": training.steps,
            "parameters": sum(parameter.numel() for parameter in training.denoiser.parameters()),
            "cpu_seconds": figures["cpu_seconds"],
            "windows": len(corpus),
            "captions": int(corpus.num_captions.sum()) // max(1, 2 * settings.conditions.paraphrases),
            "actions": len(corpus.layout.actions),
            "seconds": round(time.perf_counter() - started, 1),
        }
    )


def check_denoiser(context: StageContext, config: NermConfig) -> None:
    """Raise early what would stop this stage: missing captions for a recipe with texts, a missing encoder."""
    settings = config.denoiser
    if _encoder(settings) is None:
        return
    store = context.open_store()
    if not store.columns("captions")["captions"].map(len).any():
        raise _without_captions(f"no sequence of {context.store}", settings)


def _encoder(settings: DenoiserConfig) -> TextEncoder | None:
    if settings.conditions.text_encoder == "none":
        return None
    name, expected = settings.conditions.text_encoder, settings.conditions.text_dimension
    encoder = load_text_encoder(name)
    if expected is not None and encoder.dimension != expected:
        raise MotionkitError(
            f"the text encoder {name!r} has {encoder.dimension} dimensions, expected {expected} (the paper's CLIP "
            f"ViT-L/14 has 768): choose another with denoiser.conditions.text_encoder, or set "
            f"denoiser.conditions.text_dimension={encoder.dimension}"
        )
    return encoder


def _without_captions(who: str, settings: DenoiserConfig) -> UsageError:
    return UsageError(
        f"{who} has a caption, and denoiser.conditions.text_encoder={settings.conditions.text_encoder} learns from "
        "texts: ingest again with a table of captions (--captions captions.csv --overwrite), or train on actions and "
        "unconditionally: motionkit train --set denoiser.conditions.text_encoder=none"
    )
