"""Latent diffusion (paper §3.2, Eq. 5 and 6): the network ε_φ, its training on the field's posteriors, sampling."""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.files import sha256_of
from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.data.captions import actions_of_windows, captions_of_windows
from motionkit.generate.models import SamplingOptions
from motionkit.store.cache import cache_root
from motionkit.store.reader import Store
from motionkit.training.config import from_plain, to_plain
from motionkit.training.loop import (
    ALONE,
    Learner,
    Ranks,
    autocast,
    dropout_from,
    load_tensors,
    prefixed,
    rebuilding,
    resolve_device,
    run_training,
    save_tensors,
    seeded_initialisation,
    step_generator,
    unprefixed,
    with_precision_of,
)
from motionkit.training.networks import (
    Adjust,
    Conditions,
    ConditionSizes,
    WindowConditions,
    add_noise,
    cumulative_alphas,
    guided,
    predicted_noise,
    prediction_target,
    reparameterized,
    sample,
    sampling_steps,
    window_conditions,
)
from motionkit.training.run import RunError, RunFolder, StageContext
from motionkit.training.text import TextEncoder, embed_texts, load_text_encoder
from nerm.field import LatentSpace, TrainedField, load_field, measured_space
from nerm.latents import LocalLatents, first_read, in_use
from nerm.network import Denoiser
from nerm.paraphrases import with_paraphrases
from nerm.recipes import DenoiserConfig, NermConfig

SAMPLES_PER_BATCH = 256
WEIGHT_DECAY = 0.01
DROP, ACTION_SHARE = 0.1, 0.25


@dataclass(frozen=True, eq=False)
class LatentCorpus:
    """n posteriors with their conditions; `banks` is the layout of z (None: global)."""

    means: Float32[Tensor, "windows latent"]
    log_variances: Float32[Tensor, "windows latent"]
    conditions: WindowConditions
    banks: LocalLatents | None = None

    def __len__(self) -> int:
        return len(self.means)

    @property
    def first_read(self) -> Float32[Tensor, "latent"]:
        """The earliest instant at which the field reads each number of z (`nerm.network.first_read`)."""
        return first_read(self.means.shape[1], self.banks)

    def draw(self, rows: Int64[Tensor, "batch"], generator: torch.Generator) -> Float32[Tensor, "batch latent"]:
        """z ~ N(μ_i, Σ_i) for the windows `rows`, resampled at every call (§3.2)."""
        return reparameterized(self.means[rows], self.log_variances[rows], generator)

    def draw_conditions(self, rows: Int64[Tensor, "batch"], generator: torch.Generator) -> Conditions:
        """One condition per window: none with probability 0.1, else one of its captions or its action.

        Windows with both get the action with probability 0.25.
        """
        chance = torch.rand((3, len(rows)), generator=generator)
        return self.conditions.draw(rows, chance, drop=DROP, action_share=ACTION_SHARE)


def corpus_of(
    field: TrainedField, store: Store, encoder: TextEncoder | None, paraphrases: int, seed: int
) -> LatentCorpus:
    """A field's posteriors with their windows' captions (embedded, and cached in the store's cache folder) and actions.

    Up to `paraphrases` rewordings of each caption are drawn from `seed`; they stand for it in half of its uses.
    """
    windows, sequences = field.windows, store.columns("captions", "action")
    captions = captions_of_windows(windows, sequences) if encoder is not None else [()] * len(windows)
    captions = with_paraphrases(captions, paraphrases, np.random.default_rng(seed))

    def embed(texts: list[str]) -> Float32[Tensor, "texts dimension"]:
        """Unit-length embeddings after a row of zeros; a single zero without an encoder."""
        if encoder is None:
            return torch.zeros((1, 1))
        rows = torch.from_numpy(unit_rows(embed_texts(encoder, texts[1:], cache_root(store.path, store.fingerprint))))
        return torch.cat((torch.zeros((1, rows.shape[1])), rows))

    duration = torch.from_numpy(windows.duration_seconds / windows.max_duration_seconds).to(torch.float32)
    conditions = window_conditions(captions, actions_of_windows(windows, sequences), duration, embed)
    return LatentCorpus(field.posterior_mean, field.posterior_log_variance, conditions, field.network.local)


def unit_rows(embeddings: Float32[np.ndarray, "texts dimension"]) -> Float32[np.ndarray, "texts dimension"]:
    """Embeddings scaled to length 1; rows of zeros stay zeros."""
    lengths = np.linalg.norm(embeddings, axis=1, keepdims=True)
    return np.asarray(embeddings / np.where(lengths > 0, lengths, 1.0), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class TrainedDenoiser:
    """ε_φ with everything needed to sample latents.

    `denoiser` holds the averaged weights; `space` is its latent space; `durations` are those of the training windows in
    units of l_max; `text_encoder` and `text_fingerprint` identify the encoder it was trained with (empty without
    texts), and `field_sha256` the field whose latents it generates.
    """

    config: DenoiserConfig
    denoiser: Denoiser
    space: LatentSpace
    layout: ConditionSizes
    durations: Float32[Tensor, "windows"]
    text_encoder: str
    text_fingerprint: str
    field_sha256: str

    def sample(
        self,
        conditions: Conditions,
        *,
        seed: int,
        sampling: SamplingOptions = SamplingOptions(),
        first: int = 0,
        adjust: Adjust | None = None,
    ) -> Float32[Tensor, "batch latent"]:
        """One latent of the field per row of `conditions`; `adjust` may change each step's prediction.

        Row i depends on (seed, `first` + i) alone, not on the other rows (up to rounding of batched sums). Numbers that
        a motion of the row's duration does not use are the training mean.
        """
        config = self.with_sampling(sampling)
        generators = [step_generator(seed, "generate", first + row) for row in range(len(conditions.action))]
        batches = [slice(start, start + SAMPLES_PER_BATCH) for start in range(0, len(generators), SAMPLES_PER_BATCH)]
        latents = torch.cat(
            [self._sample_batch(config, conditions.rows(rows), generators[rows], adjust) for rows in batches]
        )
        if not torch.isfinite(latents).all():
            scale = config.diffusion.guidance_scale
            raise UsageError(f"sampling diverged: a guidance scale of {scale:g} is too large")
        return latents

    def with_sampling(self, sampling: SamplingOptions) -> DenoiserConfig:
        """The configuration with these sampling options; raises `UsageError` for unsupported ones."""
        diffusion = self.config.diffusion.adjusted(sampling.sampler, sampling.steps, sampling.guidance_scale)
        return replace(self.config, diffusion=diffusion)

    @torch.no_grad()
    def _sample_batch(
        self,
        config: DenoiserConfig,
        conditions: Conditions,
        generators: Sequence[torch.Generator],
        adjust: Adjust | None,
    ) -> Float32[Tensor, "batch latent"]:
        def draw_noise() -> Float64[Tensor, "batch latent"]:
            drawn = [torch.randn(len(self.space.mean), generator=g, dtype=torch.float64) for g in generators]
            return torch.stack(drawn)

        device = self.denoiser.positions.device
        diffusion = config.diffusion
        scale = conditions.guidance(diffusion.guidance_scale)
        on_device, nothing = conditions.to(device), conditions.unconditional().to(device)
        alphas, steps = cumulative_alphas(diffusion), sampling_steps(diffusion)

        def predict_noise(latents: Tensor, steps: Tensor) -> Tensor:
            noisy = latents.to(device, torch.float32)
            output = guided(self.denoiser, noisy, steps.to(device), on_device, nothing, scale)
            alpha = float(alphas[int(steps[0])])
            return predicted_noise(diffusion.prediction, output.to("cpu", torch.float64), latents, alpha)

        fresh = draw_noise if diffusion.sampler == "ddpm" else None
        latents = sample(predict_noise, draw_noise(), alphas, steps, draw_noise=fresh, adjust=adjust)
        used = in_use(self.denoiser.first_read.to("cpu"), conditions.duration)
        return self.space.restore(latents.to(torch.float32) * used)

    def draw_durations(self, count: int, *, seed: int, first: int = 0) -> Float32[Tensor, "count"]:
        """Sample durations of training windows, in units of l_max; number i depends on (seed, first + i) alone."""
        generators = [step_generator(seed, "duration", first + i) for i in range(count)]
        rows = [torch.randint(len(self.durations), (), generator=generator) for generator in generators]
        return self.durations[torch.stack(rows)] if rows else self.durations[:0]


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


def load_denoiser(run: RunFolder, device: str | torch.device = "cpu") -> TrainedDenoiser:
    """Read RUN/denoiser/model.safetensors; the network goes to `device`.

    Raises `RunError` if the stage was not trained to its end, `CheckpointError` for a damaged file.
    """
    folder = run.stage(STAGE_NAME)
    folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    with rebuilding(folder.model_path, STAGE_NAME):
        trained = _rebuild(tensors, description)
    trained.denoiser.to(device)
    return trained


def _rebuild(tensors: Mapping[str, Tensor], description: Mapping[str, Any]) -> TrainedDenoiser:
    config = from_plain(DenoiserConfig, description["config"])
    layout = ConditionSizes(int(description["text_dimension"]), tuple(description["actions"]))
    banks = None if description["banks"] is None else from_plain(LocalLatents, description["banks"])
    space = LatentSpace(banks, tensors["latent_mean"], tensors["latent_deviation"])
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


class DenoiserTraining:
    """A `motionkit.training.loop.Trainable`: owns the denoiser, its weight average and the optimiser.

    All random numbers come from the step's CPU generator, so that every device sees the same batches.
    """

    def __init__(
        self, config: DenoiserConfig, corpus: LatentCorpus, *, seed: int, device: torch.device, ranks: Ranks = ALONE
    ) -> None:
        self.config = config
        self.ranks = ranks
        self.corpus = corpus
        self.device = device
        self.first_read = corpus.first_read
        drawn = corpus.draw(torch.arange(len(corpus)), step_generator(seed, "latent space"))
        used = in_use(self.first_read, corpus.conditions.duration)
        self.space = measured_space(drawn, used, corpus.banks, config.latent_scale)
        self.alphas = cumulative_alphas(config.diffusion)
        self.steps = config.schedule.num_steps(len(corpus))
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
        rows = torch.randint(len(self.corpus), (schedule.batch_size,), generator=generator)
        latents = self.space.standardise(self.corpus.draw(rows, generator))
        conditions = self.corpus.draw_conditions(rows, generator)
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
    corpus = corpus_of(field, store, encoder, settings.conditions.paraphrases, context.seed)
    if encoder is not None and not corpus.conditions.num_captions.any():
        raise _without_captions(f"none of the field's {len(corpus)} training windows", settings)
    folder = context.begin(STAGE_NAME, config, store_fingerprint=store.fingerprint, builds_on=("field",))
    training = DenoiserTraining(settings, corpus, seed=context.seed, device=device, ranks=ranks)
    figures = run_training(context, training, folder)
    if not ranks.is_first:
        return
    trained = training.finished(
        text_fingerprint="" if encoder is None else encoder.fingerprint,
        field_sha256=sha256_of(context.run.stage("field").model_path),
    )
    save_denoiser(context.run, trained)
    facts = {
        "steps": training.steps,
        "parameters": sum(parameter.numel() for parameter in training.denoiser.parameters()),
        "windows": len(corpus),
        "captions": int(corpus.conditions.num_captions.sum()) // max(1, 2 * settings.conditions.paraphrases),
        "actions": len(corpus.conditions.sizes.actions),
        "wall_seconds": round(time.perf_counter() - started, 1),
    }
    folder.finish({**figures, **facts})


def check_denoiser(context: StageContext, config: NermConfig) -> None:
    """Raise early what would stop this stage: missing captions for a recipe with texts, a missing encoder."""
    settings = config.denoiser
    if _encoder(settings) is None:
        return
    store = context.open_store()
    if not store.columns("captions")["captions"].map(len).any():
        raise _without_captions(f"no sequence of {context.store}", settings)


def _encoder(settings: DenoiserConfig) -> TextEncoder | None:
    name = settings.conditions.text_encoder
    return None if name == "none" else load_text_encoder(name)


def _without_captions(who: str, settings: DenoiserConfig) -> UsageError:
    return UsageError(
        f"{who} has a caption, and denoiser.conditions.text_encoder={settings.conditions.text_encoder} learns from "
        "texts: ingest again with a table of captions (--captions captions.csv --overwrite), or train on actions and "
        "unconditionally: motionkit train --set denoiser.conditions.text_encoder=none"
    )
