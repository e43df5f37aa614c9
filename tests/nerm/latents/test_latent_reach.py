"""What of a latent a field really reads."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from nerm.field.network import FieldNetwork
from nerm.latents.local import local_latents
from nerm.latents.posterior import first_read, in_use
from nerm.recipes import demo, paper
from nerm.settings import FieldConfig

ONE_BANK = FieldConfig(
    latent_layout="local",
    latent_dimension=32,
    knots=(8,),
    knot_numbers=(4,),
    hidden=16,
    layers=2,
    time_encoding="none",
)
BANKS = replace(
    ONE_BANK,
    latent_dimension=16 * 2 + 8 * 3 + 8 * 3,
    knots=(16, 8),
    knot_numbers=(2, 3),
    path_knots=8,
    knot_kernel="lanczos",
    scaling="group",
)


@pytest.mark.parametrize("share", [0.05, 0.31, 0.8, 1.0])
@pytest.mark.parametrize("config", [ONE_BANK, BANKS], ids=["one bank", "banks"])
def test_a_field_reads_the_numbers_in_use_and_no_others(share, config):
    torch.manual_seed(0)
    network = FieldNetwork(config, 66)
    latents = torch.randn(1, config.latent_dimension, requires_grad=True)
    coordinates = torch.linspace(-1, -1 + 2 * share, 400, dtype=torch.float64)[None]
    network(latents, coordinates, torch.tensor([60.0], dtype=torch.float64)).square().sum().backward()
    assert latents.grad is not None
    used = in_use(first_read(config.latent_dimension, local_latents(config)), torch.tensor([share]))
    np.testing.assert_array_equal(latents.grad[0] != 0, used[0])


def test_a_whole_window_uses_every_number():
    for config in (demo().field, paper().field):
        assert len(first_read(config.latent_dimension, local_latents(config))) == config.latent_dimension
        assert bool(in_use(first_read(config.latent_dimension, local_latents(config)), torch.tensor([1.0])).all())


def test_without_knots_every_number_is_read_at_every_instant():
    assert bool(in_use(first_read(256, local_latents(paper().field)), torch.tensor([0.0, 1e-3])).all())
