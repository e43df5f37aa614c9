"""The denoiser: its layout, its skips, and that it learns a conditional distribution it can be checked on."""

import pytest
import torch

from motionkit.training.schedule import WeightAverage
from nerm.conditions import NO_ACTION, ConditionLayout, Conditions, guided_noise
from nerm.denoiser import Denoiser, DenoiserConfig, step_features
from nerm.diffusion import DiffusionConfig, add_noise, cumulative_alphas, sample_ddim, sampling_steps

LAYOUT = ConditionLayout(text_dimension=3, actions=("a", "b", "c"))
TINY = DenoiserConfig(num_layers=3, width=32, num_heads=2, ffn_width=64, dropout=0.0)


def action_conditions(actions: torch.Tensor) -> Conditions:
    return Conditions(text=torch.zeros(len(actions), 3), action=actions, duration=torch.ones(len(actions)))


def test_paper_sizes():
    torch.manual_seed(0)
    denoiser = Denoiser(DenoiserConfig(), 256, ConditionLayout(768, ()))
    assert len(denoiser.layers) == 9
    assert len(denoiser.skips) == 4
    per_layer = 4 * 256 * 256 + 2 * 256 * 1024
    assert sum(w.numel() for w in denoiser.layers.parameters() if w.dim() == 2) == 9 * per_layer
    assert sum(w.numel() for w in denoiser.skips.parameters() if w.dim() == 2) == 4 * 512 * 256


@pytest.mark.parametrize("latent_tokens", [1, 4, 8])
def test_every_input_reaches_every_number(latent_tokens):
    torch.manual_seed(0)
    config = DenoiserConfig(3, 32, 2, 64, 0.0, latent_tokens)
    denoiser = Denoiser(config, 8, LAYOUT)
    latents = torch.randn(2, 8, requires_grad=True)
    text, duration = torch.randn(2, 3, requires_grad=True), torch.rand(2, requires_grad=True)
    noise = denoiser(latents, torch.tensor([0, 999]), Conditions(text, torch.tensor([0, 2]), duration))
    assert noise.shape == (2, 8)
    for row in range(2):
        for number in range(8):
            gradients = torch.autograd.grad(noise[row, number], (latents, text, duration), retain_graph=True)
            for gradient in gradients:
                assert gradient[row].abs().min() > 0
                assert not gradient[1 - row].any()


def test_skips_carry_the_first_half():
    """With the second half's own input cut off, the output still sees the first half through the skips."""
    torch.manual_seed(0)
    denoiser = Denoiser(TINY, 4, LAYOUT)
    with torch.no_grad():
        denoiser.skips[0].weight[:, :32] = 0.0
    first = denoiser(torch.zeros(1, 4), torch.tensor([3]), action_conditions(torch.tensor([0])))
    second = denoiser(torch.ones(1, 4), torch.tensor([3]), action_conditions(torch.tensor([0])))
    assert not torch.allclose(first, second)


def test_step_features_tell_all_steps_apart():
    features = step_features(torch.arange(1000), 32)
    distances = torch.cdist(features, features) + 10 * torch.eye(1000)
    assert float(distances.min()) > 0.1


@pytest.mark.parametrize("wrong", [{"num_layers": 4}, {"width": 36}])
def test_impossible_sizes_are_refused(wrong):
    with pytest.raises(ValueError, match="must be"):
        DenoiserConfig(**wrong)


def test_a_latent_that_cannot_be_cut_is_refused():
    with pytest.raises(ValueError, match="cannot be cut"):
        Denoiser(DenoiserConfig(latent_tokens=3), 256, LAYOUT)


def test_learns_a_conditional_mixture():
    """Three classes of a 2-D Gaussian mixture: class means come back, guided and not; ∅ gives the mixture."""
    torch.manual_seed(0)
    generator = torch.Generator().manual_seed(0)
    means = torch.tensor([[1.5, 0.0], [-0.75, 1.3], [-0.75, -1.3]])
    diffusion = DiffusionConfig()
    alphas, denoiser = cumulative_alphas(diffusion), Denoiser(TINY, 2, LAYOUT)
    average = WeightAverage(denoiser, 0.98)
    optimiser = torch.optim.AdamW(denoiser.parameters(), lr=3e-3)
    for step in range(300):
        actions = torch.randint(3, (192,), generator=generator)
        latents = means[actions] + 0.2 * torch.randn(192, 2, generator=generator)
        actions[torch.rand(192, generator=generator) < 0.15] = NO_ACTION
        noise, steps = torch.randn(192, 2, generator=generator), torch.randint(1000, (192,), generator=generator)
        predicted = denoiser(add_noise(latents, noise, steps, alphas), steps, action_conditions(actions))
        optimiser.zero_grad()
        (predicted - noise).square().mean().backward()
        optimiser.step()
        average.update(denoiser, step)

    denoiser.load_state_dict(average.tensors())

    def sample(actions: torch.Tensor, guidance_scale: float) -> torch.Tensor:
        start = torch.randn(len(actions), 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
        given = action_conditions(actions)

        def predict(z, k):
            return guided_noise(denoiser, z.float(), k, given, guidance_scale)

        with torch.inference_mode():
            return sample_ddim(predict, start, alphas, sampling_steps(diffusion)).float()

    for action in range(3):
        found = sample(torch.full((300,), action), 1.0)
        assert float((found.mean(0) - means[action]).norm()) < 0.15
        assert float(found.std(0).mean()) < 0.5
        guided = sample(torch.full((300,), action), 2.0)
        nearest = torch.cdist(guided, means).argmin(1)
        assert float((nearest == action).float().mean()) > 0.97
    mixture = sample(torch.full((600,), NO_ACTION), 7.5)
    shares = torch.cdist(mixture, means).argmin(1).bincount(minlength=3) / 600
    assert float(shares.min()) > 0.2
