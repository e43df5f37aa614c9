"""Stage `denoiser`: from a run's field and the store it was trained on to a trained latent diffusion."""

import time

from motionkit.store.reader import Store
from motionkit.training.device import resolve_device
from motionkit.training.loop import train_loop
from motionkit.training.run import RunError
from motionkit.training.stage import StageContext
from nerm.denoiser_training import DenoiserTraining
from nerm.field_corpus import corpus_of
from nerm.field_model import load_field
from nerm.local_latents import local_latents
from nerm.recipes import NermConfig
from nerm.text_encoders import file_sha256, load_text_encoder
from nerm.trained_denoiser import STAGE_NAME, save_denoiser


def train_denoiser(context: StageContext, config: NermConfig) -> None:
    """Train ε_φ on the latents of RUN/field; writes the denoiser and what sampling needs to model.safetensors.

    Raises `RunError` where the field is missing or was trained on another state of the store: captions are looked up in
    the store by its windows' sequences.
    """
    settings, store = config.denoiser, Store.open(context.store)
    field = load_field(context.run)
    if field.store_fingerprint != store.fingerprint:
        raise RunError(
            f"the field of {context.run.path} was trained on a store of fingerprint {field.store_fingerprint[:16]}, "
            f"{context.store} has {store.fingerprint[:16]}: train the field again, or give --store"
        )
    folder = context.begin(STAGE_NAME, config, store_fingerprint=store.fingerprint)
    started = time.perf_counter()
    encoder = None if settings.text_encoder == "none" else load_text_encoder(settings.text_encoder)
    corpus = corpus_of(
        field.posterior_mean,
        field.posterior_log_variance,
        field.windows,
        store,
        encoder,
        local_latents(field.config),
    )
    training = DenoiserTraining(settings, corpus, seed=context.seed, device=resolve_device(context.device))
    figures = train_loop(training, folder, steps=training.num_steps, seed=context.seed)
    trained = training.finished(
        text_fingerprint="" if encoder is None else encoder.fingerprint,
        field_sha256=file_sha256(context.run.stage("field").model_path),
    )
    save_denoiser(context.run, trained)
    folder.finish(
        {
            "loss": figures["loss"],
            "steps": training.num_steps,
            "windows": len(corpus),
            "captions": int(corpus.num_captions.sum()),
            "actions": len(corpus.layout.actions),
            "seconds": round(time.perf_counter() - started, 1),
        }
    )
