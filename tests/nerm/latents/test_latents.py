import pytest
import torch
from torch.distributions import Normal, kl_divergence

from nerm.latents import posterior
from nerm.latents.posterior import RowAdam, sample_posterior


@pytest.mark.parametrize("weight_decay", [0.0, 0.5])
def test_rows_that_are_touched_follow_dense_adamw_and_others_stay(weight_decay: float) -> None:
    generator = torch.Generator().manual_seed(0)
    table = torch.randn(10, 4, generator=generator)
    touched = torch.tensor([1, 4, 7])
    dense = table[touched].clone().requires_grad_()
    reference = torch.optim.AdamW([dense], lr=0.03, weight_decay=weight_decay)
    sparse = RowAdam(table.clone(), weight_decay=weight_decay)
    for _ in range(25):
        gradient = torch.randn(3, 4, generator=generator)
        dense.grad = gradient.clone()
        reference.step()
        sparse.update(touched, gradient, 0.03)
    torch.testing.assert_close(sparse.table[touched], dense.detach(), atol=1e-6, rtol=1e-5)
    others = torch.tensor([0, 2, 3, 5, 6, 8, 9])
    assert torch.equal(sparse.table[others], table[others])
    assert sparse.count.squeeze(1).tolist() == [25.0 if row in (1, 4, 7) else 0.0 for row in range(10)]


def test_a_row_s_steps_do_not_depend_on_when_they_come() -> None:
    gradients = torch.randn(6, 1, 3, generator=torch.Generator().manual_seed(1))
    alone, interleaved = RowAdam(torch.zeros(2, 3)), RowAdam(torch.zeros(2, 3))
    for gradient in gradients:
        alone.update(torch.tensor([0]), gradient, 0.1)
        interleaved.update(torch.tensor([1]), gradient * 2, 0.1)
        interleaved.update(torch.tensor([0]), gradient, 0.1)
    assert torch.equal(alone.table[0], interleaved.table[0])


def test_kl_is_that_of_normal_distributions() -> None:
    mean, log_variance = torch.randn(5, 7), torch.randn(5, 7)
    expected = kl_divergence(Normal(mean, torch.exp(0.5 * log_variance)), Normal(0.0, 1.0)).mean()
    torch.testing.assert_close(posterior.kl_divergence(mean, log_variance), expected)


def test_samples_have_the_posterior_s_mean_and_deviation() -> None:
    noise = torch.randn(200_000, 2, generator=torch.Generator().manual_seed(2))
    mean, log_variance = (
        torch.tensor([1.0, -2.0]).expand(len(noise), 2),
        torch.tensor([0.0, -2.0]).expand(len(noise), 2),
    )
    samples = sample_posterior(mean, log_variance, noise)
    torch.testing.assert_close(samples.mean(0), torch.tensor([1.0, -2.0]), atol=0.01, rtol=0)
    torch.testing.assert_close(samples.std(0), torch.exp(torch.tensor([0.0, -1.0])), atol=0.01, rtol=0)
