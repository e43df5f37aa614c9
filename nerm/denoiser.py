"""Stage `denoiser`: training ε_φ on the latents of a trained field (paper §3.2, Eq. 5)."""

import dataclasses
import time
from collections import Counter
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.files import sha256_of
from motionkit.core.shapes import Float32
from motionkit.data.captions import actions_of_windows, captions_of_windows
from motionkit.data.windows import open_frames
from motionkit.store.cache import cache_root
from motionkit.store.reader import Store
from motionkit.training.loop import Learner, dropout_from, run_training, seeded_initialisation, step_generator
from motionkit.training.networks import (
    ALONE,
    Ranks,
    WindowConditions,
    add_noise,
    autocast,
    cumulative_alphas,
    prediction_target,
    reparameterized,
    resolve_device,
    window_conditions,
    with_precision_of,
)
from motionkit.training.run import RunError, StageContext
from motionkit.training.text import TextEncoder, embed_texts, load_text_encoder
from nerm.encoding import encode_varied, vary
from nerm.latents import LocalLatents, first_read, in_use, measured_space
from nerm.model import TrainedDenoiser, TrainedField, load_field, save_denoiser, unit_rows
from nerm.network import Denoiser
from nerm.paraphrases import with_paraphrases
from nerm.recipes import DenoiserConfig, NermConfig

WEIGHT_DECAY = 0.01
# Shares of windows without a condition, and of those with a text and an action that get the action.
DROP, ACTION_SHARE = 0.1, 0.25
# Times the largest number of all posteriors: a varied window's latent beyond it is left out.
FARTHEST = 3.0


@dataclass(frozen=True, eq=False)
class LatentCorpus:
    """n posteriors with their conditions; `banks` is the layout of z (None: global).

    A step draws windows in proportion to `weights` (None: evenly).
    """

    means: Float32[Tensor, "windows latent"]
    log_variances: Float32[Tensor, "windows latent"]
    conditions: WindowConditions
    banks: LocalLatents | None = None
    weights: Float32[Tensor, "windows"] | None = None


def corpus_of(
    field: TrainedField, store: Store, encoder: TextEncoder | None, config: DenoiserConfig, seed: int
) -> LatentCorpus:
    """A field's posteriors with their windows' captions (embedded, and cached in the store's cache folder) and actions.

    With local latents `config.variations` of each window are encoded (`nerm.encoding.vary`) and get its posterior's
    variance. If `config.balanced`, windows are weighted so that each caption (or action) is drawn equally often. Up to
    `paraphrases` rewordings of each caption are drawn from `seed`; they stand for it in half of its uses.
    """
    windows, captioned, means = [field.windows], [field.windows], [field.posterior_mean]
    log_variances, farthest = [field.posterior_log_variance], FARTHEST * field.posterior_mean.abs().amax(dim=0)
    rng = np.random.default_rng(seed)
    if field.linear_model is not None and config.variations:
        source, frames = open_frames(field.vectors, store, field.config.where)
        for _ in range(config.variations):
            varied, at_own_tempo = vary(field.windows, source, rng)
            latents = encode_varied(field.linear_model, varied, frames)
            # A field that learnt from few motions cannot hold their mirror images.
            held = (latents.abs() <= farthest).all(dim=1)
            windows.append(varied.select(held.numpy()))
            captioned.append(at_own_tempo.select(held.numpy()))
            means.append(latents[held])
            log_variances.append(field.posterior_log_variance[held])
    sequences = store.columns("captions", "action")
    captions = [of for each in captioned for of in captions_of_windows(each, sequences)]
    if encoder is None:
        captions = [()] * len(captions)
    actions = [action for each in captioned for action in actions_of_windows(each, sequences)]
    weights = None
    if config.balanced:
        labels = [texts[0] if texts else action for texts, action in zip(captions, actions, strict=True)]
        counts = Counter(labels)
        weights = torch.tensor([1.0 / counts[label] for label in labels])
    captions = with_paraphrases(captions, config.conditions.paraphrases, np.random.default_rng(seed))

    def embed(texts: list[str]) -> Float32[Tensor, "texts dimension"]:
        """Unit-length embeddings after a row of zeros; a single zero without an encoder."""
        if encoder is None:
            return torch.zeros((1, 1))
        rows = torch.from_numpy(unit_rows(embed_texts(encoder, texts[1:], cache_root(store.path, store.fingerprint))))
        return torch.cat((torch.zeros((1, rows.shape[1])), rows))

    seconds = np.concatenate([each.duration_seconds for each in windows])
    duration = torch.from_numpy(seconds / field.max_duration_seconds).to(torch.float32)
    conditions = window_conditions(captions, actions, duration, embed)
    return LatentCorpus(torch.cat(means), torch.cat(log_variances), conditions, field.network.local, weights)


class DenoiserTraining:
    """A `motionkit.training.loop.Trainable`: owns the denoiser, its weight average and the optimiser.

    All random numbers come from the step's CPU generator, so that every device sees the same batches.
    """

    def __init__(
        self, config: DenoiserConfig, corpus: LatentCorpus, *, seed: int, device: torch.device, ranks: Ranks = ALONE
    ) -> None:
        self.config, self.corpus, self.device, self.ranks = config, corpus, device, ranks
        self.first_read = first_read(corpus.means.shape[1], corpus.banks)
        drawn = reparameterized(corpus.means, corpus.log_variances, step_generator(seed, "latent space"))
        used = in_use(self.first_read, corpus.conditions.duration)
        self.space = measured_space(drawn, used, corpus.banks)
        self.alphas = cumulative_alphas(config.diffusion)
        self.steps = config.schedule.num_steps(len(corpus.means))
        with seeded_initialisation(seed, "denoiser"):
            self.denoiser = Denoiser(config.network, self.first_read, corpus.conditions.sizes).to(device)
        optimizer = torch.optim.AdamW(
            self.denoiser.parameters(), lr=config.schedule.learning_rate, weight_decay=WEIGHT_DECAY
        )
        self.learner = Learner(self.denoiser, optimizer, config.ema_decay, ranks)
        self.state_tensors, self.load_state_tensors = self.learner.state_tensors, self.learner.load_state_tensors

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """One optimiser step on a fresh batch; returns the loss of Eq. 5 (mean over the numbers in use)."""
        config, diffusion, schedule = self.config, self.config.diffusion, self.config.schedule
        mine = self.ranks.rows_of(schedule.batch_size)
        if (weights := self.corpus.weights) is None:
            rows = torch.randint(len(self.corpus.means), (schedule.batch_size,), generator=generator)
        else:
            rows = torch.multinomial(weights, schedule.batch_size, replacement=True, generator=generator)
        drawn = reparameterized(self.corpus.means[rows], self.corpus.log_variances[rows], generator)  # anew (§3.2)
        latents = self.space.standardise(drawn)
        chance = torch.rand((3, len(rows)), generator=generator)
        conditions = self.corpus.conditions.draw(rows, chance, drop=DROP, action_share=ACTION_SHARE)
        steps = torch.randint(diffusion.num_steps, (schedule.batch_size,), generator=generator)
        noise = torch.randn(latents.shape, generator=generator)
        noisy = add_noise(latents, noise, steps, self.alphas)
        target = prediction_target(diffusion.prediction, latents, noise, steps, self.alphas)
        given = conditions.rows(mine)
        with dropout_from(generator, self.device, self.ranks.rank), autocast(config.precision, self.device):
            output = self.denoiser(noisy[mine].to(self.device), steps[mine].to(self.device), given.to(self.device))
        used = in_use(self.first_read, conditions.duration)
        weights = used / used.sum()
        loss = ((output.float() - target[mine].to(self.device)).square() * weights[mine].to(self.device)).sum()
        self.learner.descend(loss, step, schedule.factor(step, self.steps) * schedule.learning_rate)
        return {"loss": loss.detach()}

    def finished(self, *, text_fingerprint: str, field_sha256: str) -> TrainedDenoiser:
        """The trained denoiser, with its averaged weights, on the CPU."""
        denoiser = deepcopy(self.denoiser).cpu()
        denoiser.load_state_dict(self.learner.trained_tensors())
        return TrainedDenoiser(
            config=self.config,
            denoiser=denoiser.eval().requires_grad_(False),
            space=self.space,
            layout=self.corpus.conditions.sizes,
            durations=self.corpus.conditions.duration,
            text_encoder=self.config.conditions.text_encoder,
            text_fingerprint=text_fingerprint,
            field_sha256=field_sha256,
        )


def train_denoiser(context: StageContext, config: NermConfig) -> None:
    """Train ε_φ on the latents of RUN/field; write the denoiser and what sampling needs to model.safetensors.

    Raises `RunError` if the field is missing or was trained on another state of the store (captions are looked up in
    the store by its windows' sequences).
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
    corpus = corpus_of(field, store, encoder, settings, context.seed)
    folder = context.begin("denoiser", config, store_fingerprint=store.fingerprint, builds_on=("field",))
    training = DenoiserTraining(settings, corpus, seed=context.seed, device=device, ranks=ranks)
    figures = run_training(context, training, folder)
    if not ranks.is_first:
        return
    trained = training.finished(
        text_fingerprint="" if encoder is None else encoder.fingerprint,
        field_sha256=sha256_of(context.run.stage("field").model_path),
    )
    save_denoiser(folder, trained)
    facts = {
        "steps": training.steps,
        "parameters": sum(parameter.numel() for parameter in training.denoiser.parameters()),
        "windows": len(field.windows),
        "latents": len(corpus.means),
        "captions": int(corpus.conditions.num_captions.sum()) // max(1, 2 * settings.conditions.paraphrases),
        "actions": len(corpus.conditions.sizes.actions),
        "wall_seconds": round(time.perf_counter() - started, 1),
    }
    folder.finish({**figures, **facts})


def check_denoiser(context: StageContext, config: NermConfig) -> None:
    """Raise early what would stop this stage: missing captions for a recipe with texts, a missing encoder."""
    settings = config.denoiser
    if _encoder(settings) is None or context.open_store().columns("captions")["captions"].map(len).any():
        return
    raise UsageError(
        f"no sequence of {context.store} has a caption, and denoiser.conditions.text_encoder="
        f"{settings.conditions.text_encoder} learns from texts: ingest again with a table of captions (--captions "
        "captions.csv --overwrite), or train on actions and unconditionally: motionkit train --set "
        "denoiser.conditions.text_encoder=none"
    )


def _encoder(settings: DenoiserConfig) -> TextEncoder | None:
    name = settings.conditions.text_encoder
    return None if name == "none" else load_text_encoder(name)
