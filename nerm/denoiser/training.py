"""Training of the latent denoiser ε_φ by Eq. 5 on a corpus of posteriors."""

from collections.abc import Mapping

import torch
from torch import Tensor

from motionkit.training.devices import ALONE, Ranks, autocast, compile_each
from motionkit.training.diffusion.process import add_noise, cumulative_alphas, loss_weights, prediction_target
from motionkit.training.loop import (
    WeightAverage,
    dropout_from,
    seeded_initialisation,
    set_rate,
    step_generator,
)
from motionkit.training.tensors import load_training_tensors, prefixed, training_tensors, unprefixed
from nerm.conditions import Conditions
from nerm.denoiser.corpus import LatentCorpus
from nerm.denoiser.latent_space import measured_space
from nerm.denoiser.network import Denoiser
from nerm.denoiser.trained import TrainedDenoiser
from nerm.latents.posterior import in_use
from nerm.settings import DenoiserConfig


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
        drawn = corpus.draw(torch.arange(len(corpus)), step_generator(seed, "latent space", 0))
        used = in_use(self.first_read, corpus.duration)
        self.space = measured_space(drawn, used, corpus.banks, config.latents.path, config.latents.scale)
        self.alphas = cumulative_alphas(config.diffusion)
        self.weights = loss_weights(config.diffusion.prediction, config.diffusion.loss, self.alphas)
        self.steps = config.schedule.num_steps(len(corpus))
        with seeded_initialisation(seed, "denoiser"):
            self.denoiser = Denoiser(config.network, self.first_read, corpus.layout).to(device)
        if config.compile:
            compile_each(self.denoiser.layers)
        self.average = WeightAverage(self.denoiser, config.ema_decay)
        self.optimizer = torch.optim.AdamW(
            self.denoiser.parameters(), lr=config.schedule.learning_rate, weight_decay=config.weight_decay
        )

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, Tensor]:
        """One optimiser step on a fresh batch; returns the loss of Eq. 5 (mean over the numbers in use)."""
        config, diffusion, schedule = self.config, self.config.diffusion, self.config.schedule
        set_rate(self.optimizer, schedule.factor(step, self.steps) * schedule.learning_rate)
        mine = self.ranks.rows_of(schedule.batch_size)
        rows = torch.randint(len(self.corpus), (schedule.batch_size,), generator=generator)
        latents = self.space.standardise(self.corpus.draw(rows, generator))
        conditions = self.corpus.draw_conditions(
            rows, generator, drop=config.conditions.drop, action_share=config.conditions.action_share
        )
        steps = torch.randint(diffusion.num_steps, (schedule.batch_size,), generator=generator)
        noise = torch.randn(latents.shape, generator=generator)
        noisy = add_noise(latents, noise, steps, self.alphas)
        target = prediction_target(diffusion.prediction, latents, noise, steps, self.alphas)
        given = Conditions(conditions.text[mine], conditions.action[mine], conditions.duration[mine])
        with dropout_from(generator, self.device, self.ranks.rank), autocast(config.precision, self.device):
            output = self.denoiser(noisy[mine].to(self.device), steps[mine].to(self.device), given.to(self.device))
        used = in_use(self.first_read, conditions.duration)
        weights = used * self.weights[steps, None].to(torch.float32) / used.sum()
        loss = ((output.float() - target[mine].to(self.device)).square() * weights[mine].to(self.device)).sum()
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.ranks.add_up_gradients(self.denoiser.parameters())
        self.optimizer.step()
        self.average.update(self.denoiser, step)
        return {"loss": loss.detach()}

    def finished(self, *, text_fingerprint: str, field_sha256: str) -> TrainedDenoiser:
        """The trained denoiser, with its averaged weights, on the CPU."""
        with seeded_initialisation(0, "denoiser"):
            denoiser = Denoiser(self.config.network, self.first_read, self.corpus.layout)
        denoiser.load_state_dict(self.average.tensors())
        return TrainedDenoiser(
            config=self.config,
            denoiser=denoiser.eval().requires_grad_(False),
            space=self.space,
            layout=self.corpus.layout,
            durations=self.corpus.duration,
            text_encoder=self.config.conditions.text_encoder,
            text_fingerprint=text_fingerprint,
            field_sha256=field_sha256,
        )

    def state_tensors(self) -> dict[str, Tensor]:
        """Weights, their average, the optimiser's moments."""
        return training_tensors("denoiser", self.denoiser, self.optimizer) | prefixed("average", self.average.tensors())

    def load_state_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore what `state_tensors` returned."""
        load_training_tensors("denoiser", self.denoiser, self.optimizer, tensors)
        self.average.load(unprefixed("average", tensors))
