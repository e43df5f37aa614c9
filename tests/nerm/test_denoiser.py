"""The denoiser: its sizes, its tokens, its skips."""

import pytest
import torch

from nerm.conditions import ConditionLayout, Conditions
from nerm.denoiser import Denoiser, step_features
from nerm.denoiser_config import TransformerConfig

LAYOUT = ConditionLayout(text_dimension=3, actions=("a", "b", "c"))
TINY = TransformerConfig(num_layers=3, width=32, num_heads=2, ffn_width=64, dropout=0.0)


def action_conditions(actions: torch.Tensor) -> Conditions:
    return Conditions(text=torch.zeros(len(actions), 3), action=actions, duration=torch.ones(len(actions)))


def test_paper_sizes():
    torch.manual_seed(0)
    denoiser = Denoiser(TransformerConfig(), 256, ConditionLayout(768, ()))
    assert len(denoiser.layers) == 9
    assert len(denoiser.skips) == 4
    per_layer = 4 * 256 * 256 + 2 * 256 * 1024
    assert sum(w.numel() for w in denoiser.layers.parameters() if w.dim() == 2) == 9 * per_layer
    assert sum(w.numel() for w in denoiser.skips.parameters() if w.dim() == 2) == 4 * 512 * 256


@pytest.mark.parametrize("latent_tokens", [1, 4, 8])
def test_every_input_reaches_every_number(latent_tokens):
    torch.manual_seed(0)
    config = TransformerConfig(3, 32, 2, 64, 0.0, latent_tokens)
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
        TransformerConfig(**wrong)


def test_a_latent_that_cannot_be_cut_is_refused():
    with pytest.raises(ValueError, match="cannot be cut"):
        Denoiser(TransformerConfig(latent_tokens=3), 256, LAYOUT)
