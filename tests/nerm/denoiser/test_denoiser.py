"""The denoiser: its sizes, its tokens, its skips."""

import pytest
import torch

from nerm.conditions import ConditionLayout, Conditions
from nerm.denoiser.network import Denoiser, attention, step_features
from nerm.latents.posterior import ALWAYS, in_use
from nerm.settings import TransformerConfig

LAYOUT = ConditionLayout(text_dimension=3, actions=("a", "b", "c"))
TINY = TransformerConfig(num_layers=3, width=32, num_heads=2, ffn_width=64, dropout=0.0)


def action_conditions(actions: torch.Tensor) -> Conditions:
    return Conditions(text=torch.zeros(len(actions), 3), action=actions, duration=torch.ones(len(actions)))


def test_paper_sizes():
    torch.manual_seed(0)
    denoiser = Denoiser(TransformerConfig(), torch.full((256,), ALWAYS), ConditionLayout(768, ()))
    assert len(denoiser.layers) == 9
    assert len(denoiser.skips) == 4
    per_layer = 4 * 256 * 256 + 2 * 256 * 1024
    assert sum(w.numel() for w in denoiser.layers.parameters() if w.dim() == 2) == 9 * per_layer
    assert sum(w.numel() for w in denoiser.skips.parameters() if w.dim() == 2) == 4 * 512 * 256


@pytest.mark.parametrize("num_tokens", [1, 4, 8])
def test_every_input_reaches_every_number(num_tokens):
    torch.manual_seed(0)
    config = TransformerConfig(3, 32, 2, 64, 0.0, num_tokens)
    denoiser = Denoiser(config, torch.full((8,), ALWAYS), LAYOUT)
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
    denoiser = Denoiser(TINY, torch.full((4,), ALWAYS), LAYOUT)
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


def test_what_a_motion_does_not_depend_on_is_neither_read_nor_put_out():
    """A motion of 0.4 l_max reads 9 of 16 numbers: the other half may hold anything."""
    torch.manual_seed(0)
    first_read = torch.linspace(-0.4, 0.95, 16)
    denoiser = Denoiser(TransformerConfig(3, 32, 2, 64, 0.0, 4), first_read, LAYOUT)
    latents, steps = torch.randn(3, 16), torch.tensor([0, 500, 999])
    conditions = Conditions(torch.zeros(3, 3), torch.tensor([0, 1, 2]), torch.tensor([0.4, 0.4, 1.0]))
    used = in_use(first_read, conditions.duration)
    assert used.sum(dim=1).tolist() == [9, 9, 16]
    out = denoiser(latents, steps, conditions)
    assert not out[~used].any()
    assert out[used].abs().min() > 0
    changed = denoiser(torch.where(used, latents, torch.full_like(latents, 100.0)), steps, conditions)
    torch.testing.assert_close(changed, out, rtol=0, atol=0)
    alone = denoiser(latents[:1], steps[:1], conditions.rows(slice(0, 1)))
    torch.testing.assert_close(alone, out[:1], rtol=1e-5, atol=1e-6)


def test_a_latent_that_cannot_be_cut_is_refused():
    with pytest.raises(ValueError, match="cannot be cut"):
        Denoiser(TransformerConfig(latent_tokens=3), torch.full((256,), ALWAYS), LAYOUT)


def test_attention_in_bfloat16_is_that_in_float32():
    generator = torch.Generator().manual_seed(0)
    heads = torch.randn(3, 5, 2, 7, 16, generator=generator)
    seen = torch.arange(7)[None, None, None] < torch.tensor([7, 6, 4, 2, 1])[:, None, None, None]
    rough = [each.to(torch.bfloat16).requires_grad_() for each in heads]
    exact = [each.detach().float().requires_grad_() for each in rough]
    for mask in (None, seen):
        found, expected = attention(*rough, mask), attention(*exact, mask)
        assert found.dtype == torch.bfloat16
        torch.testing.assert_close(found.float(), expected, atol=0.02, rtol=0.02)
        slopes = [
            torch.autograd.grad(each.float().square().sum(), of) for each, of in ((found, rough), (expected, exact))
        ]
        for ours, theirs in zip(*slopes, strict=True):
            torch.testing.assert_close(ours.float(), theirs, atol=0.06, rtol=0.06)
