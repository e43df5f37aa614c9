"""Zero masks, guidance (Eq. 6), and which captions belong to a window."""

import torch

from motionkit.training.networks import NO_ACTION, Conditions, guided


def conditions(batch: int = 3) -> Conditions:
    generator = torch.Generator().manual_seed(0)
    return Conditions.zero_masked(
        text=torch.randn(batch, 5, generator=generator),
        action=torch.arange(batch) % 2,
        duration=torch.linspace(0.2, 1.0, batch),
    )


class Recorder:
    """A 'denoiser' whose answer depends on the condition, and which remembers the batches it was given."""

    def __init__(self):
        self.batches = []

    def __call__(self, latents, steps, given):
        self.batches.append(len(latents))
        return latents + given.text.sum(dim=1, keepdim=True) + 10 * given.action[:, None] + given.duration[:, None]


def test_guidance_is_equation_6_in_one_batch():
    denoiser, given_conditions = Recorder(), conditions()
    latents, steps = torch.randn(3, 4, generator=torch.Generator().manual_seed(1)), torch.full((3,), 7)
    found = guided(denoiser, latents, steps, given_conditions, given_conditions.unconditional(), 7.5)
    assert denoiser.batches == [6]
    with_condition = denoiser(latents, steps, given_conditions)
    without = denoiser(latents, steps, given_conditions.unconditional())
    torch.testing.assert_close(found, 7.5 * with_condition - 6.5 * without)


def test_guidance_of_one_and_of_nothing_is_a_single_pass():
    denoiser, given_conditions = Recorder(), conditions()
    latents, steps = torch.zeros(3, 4), torch.full((3,), 7)
    nothing = given_conditions.unconditional()
    guided(denoiser, latents, steps, given_conditions, nothing, 1.0)
    guided(denoiser, latents, steps, nothing, nothing, nothing.guidance(7.5))
    assert denoiser.batches == [3, 3] and given_conditions.guidance(7.5) == 7.5


def test_dropping_masks_with_zeros_and_keeps_the_duration():
    given_conditions = conditions()
    dropped = given_conditions.dropped(torch.tensor([True, False, True]))
    assert not dropped.text[[0, 2]].any()
    assert dropped.action.tolist() == [NO_ACTION, 1, NO_ACTION]
    torch.testing.assert_close(dropped.text[1], given_conditions.text[1])
    torch.testing.assert_close(dropped.duration, given_conditions.duration)
