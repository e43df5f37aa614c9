"""The diffusion process against `diffusers`, and against distributions whose denoiser is known in closed form."""

import diffusers
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motionkit.training.config import DiffusionConfig
from motionkit.training.networks import (
    add_noise,
    cumulative_alphas,
    predicted_noise,
    prediction_target,
    sample,
    sampling_steps,
)


def reference(config: DiffusionConfig, kind: str):
    kinds = {"noise": "epsilon", "latent": "sample", "velocity": "v_prediction"}
    schedules = {"scaled_linear": "scaled_linear", "cosine": "squaredcos_cap_v2"}
    options = {
        "clip_sample": False,
        "prediction_type": kinds[config.prediction],
        "timestep_spacing": config.sampling_spacing,
    }
    common = {
        "num_train_timesteps": config.num_steps,
        "beta_start": config.beta_start,
        "beta_end": config.beta_end,
        "beta_schedule": schedules[config.schedule],
        "steps_offset": 1 if config.sampling_spacing == "leading" else 0,
    }
    if kind == "ddim":
        scheduler = diffusers.DDIMScheduler(**common, **options, set_alpha_to_one=True)
    else:
        scheduler = diffusers.DDPMScheduler(**common, **options, variance_type="fixed_small")
    scheduler.set_timesteps(config.sampling_steps)
    return scheduler


def wobbly(latents: torch.Tensor, steps: torch.Tensor) -> torch.Tensor:
    return torch.sin(3 * latents) + 0.001 * steps[:, None]


def test_add_noise_agrees_with_diffusers():
    generator = torch.Generator().manual_seed(0)
    latents, noise = torch.randn(5, 3, generator=generator), torch.randn(5, 3, generator=generator)
    steps = torch.tensor([0, 1, 500, 998, 999])
    expected = reference(DiffusionConfig(), "ddpm").add_noise(latents, noise, steps)
    found = add_noise(latents, noise, steps, cumulative_alphas(DiffusionConfig()))
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)


def noise_by(config: DiffusionConfig):
    """`wobbly` as a network's output of the configured kind, turned into the noise that our samplers take."""
    alphas = cumulative_alphas(config)

    def predict(latents, steps):
        return predicted_noise(config.prediction, wobbly(latents, steps), latents, float(alphas[int(steps[0])]))

    return predict


PROCESSES = [
    DiffusionConfig(),
    DiffusionConfig(sampling_spacing="leading"),
    DiffusionConfig(prediction="latent"),
    DiffusionConfig(prediction="velocity"),
    DiffusionConfig(prediction="velocity", schedule="cosine"),
    DiffusionConfig(prediction="latent", schedule="cosine", sampling_steps=20),
]


@pytest.mark.parametrize("kind", ["ddim", "ddpm"])
@pytest.mark.parametrize("config", PROCESSES)
def test_samplers_agree_with_diffusers(config, kind):
    scheduler = reference(config, kind)
    start = torch.randn(6, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    theirs, ours = torch.Generator().manual_seed(2), torch.Generator().manual_seed(2)
    expected = start
    for step in scheduler.timesteps:
        output = wobbly(expected, step.expand(6))
        expected = scheduler.step(output, step, expected, generator=theirs).prev_sample
    drawing = {"draw_noise": lambda: torch.randn(6, 4, generator=ours, dtype=torch.float64)} if kind == "ddpm" else {}
    found = sample(noise_by(config), start, cumulative_alphas(config), sampling_steps(config), **drawing)
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3)


@given(step=st.integers(0, 999), config=st.sampled_from(PROCESSES))
@settings(max_examples=30)
def test_what_is_predicted_leads_back_to_the_noise(step, config):
    generator = torch.Generator().manual_seed(step)
    latents = torch.randn(4, 6, generator=generator, dtype=torch.float64)
    noise = torch.randn(4, 6, generator=generator, dtype=torch.float64)
    alphas, steps = cumulative_alphas(config), torch.full((4,), step)
    noisy = add_noise(latents, noise, steps, alphas)
    target = prediction_target(config.prediction, latents, noise, steps, alphas)
    found = predicted_noise(config.prediction, target, noisy, float(alphas[step]))
    torch.testing.assert_close(found, noise, rtol=1e-9, atol=1e-9)
