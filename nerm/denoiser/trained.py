"""A trained denoiser, and sampling latents with it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float32, Float64
from motionkit.generate.models import SamplingOptions
from motionkit.training.config import from_plain, to_plain
from motionkit.training.diffusion.process import (
    Adjust,
    cumulative_alphas,
    predicted_noise,
    sample,
    sampling_steps,
)
from motionkit.training.loop import seeded_initialisation, step_generator
from motionkit.training.run import RunFolder
from motionkit.training.tensors import load_tensors, prefixed, rebuilding, save_tensors, unprefixed
from nerm.conditions import ConditionLayout, Conditions, guided
from nerm.denoiser.latent_space import LatentSpace
from nerm.denoiser.network import Denoiser
from nerm.latents.local import LocalLatents
from nerm.latents.posterior import in_use
from nerm.settings import DenoiserConfig

SAMPLES_PER_BATCH = 256


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
    layout: ConditionLayout
    durations: Float32[Tensor, "windows"]
    text_encoder: str
    text_fingerprint: str
    field_sha256: str

    @property
    def latent_dimension(self) -> int:
        """Numbers in a latent."""
        return len(self.space.mean)

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
        found = []
        for start in range(0, len(generators), SAMPLES_PER_BATCH):
            rows = slice(start, start + SAMPLES_PER_BATCH)
            found.append(self._sample_batch(config, conditions.rows(rows), generators[rows], adjust))
        latents = torch.cat(found)
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
            drawn = [torch.randn(self.latent_dimension, generator=g, dtype=torch.float64) for g in generators]
            return torch.stack(drawn)

        device = self.denoiser.positions.device
        on_device = conditions.to(device)
        diffusion = config.diffusion
        alphas, steps = cumulative_alphas(diffusion), sampling_steps(diffusion)

        def predict_noise(latents: Tensor, steps: Tensor) -> Tensor:
            noisy = latents.to(device, torch.float32)
            output = guided(self.denoiser, noisy, steps.to(device), on_device, diffusion.guidance_scale)
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


def load_denoiser(run: RunFolder, device: torch.device | None = None) -> TrainedDenoiser:
    """Read RUN/denoiser/model.safetensors; the network goes to `device` (default: the CPU).

    Raises `RunError` if the stage was not trained to its end, `CheckpointError` for a damaged file.
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
    space = LatentSpace(banks, config.latents.path, tensors["latent_mean"], tensors["latent_deviation"])
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
