"""What of a latent a field really reads."""

import numpy as np
import pytest
import torch

from motionkit.training.config import apply_overrides
from nerm.field.network import FieldNetwork
from nerm.latents.local import local_latents
from nerm.latents.posterior import first_read, in_use
from nerm.recipes import demo, paper
from nerm.settings import FieldConfig

ONE_BANK = apply_overrides(
    FieldConfig(),
    [
        "latents.layout=local",
        "latents.dimension=32",
        "latents.knots=8",
        "latents.knot_numbers=4",
        "decoder.width=16",
        "decoder.num_layers=2",
        "encoder.kind=none",
    ],
)
BANKS = apply_overrides(
    ONE_BANK,
    [
        f"latents.dimension={16 * 2 + 8 * 3 + 8 * 3}",
        "latents.knots=16,8",
        "latents.knot_numbers=2,3",
        "latents.path_knots=8",
        "latents.kernel=lanczos",
        "loss.scaling=group",
    ],
)


@pytest.mark.parametrize("share", [0.05, 0.31, 0.8, 1.0])
@pytest.mark.parametrize("config", [ONE_BANK, BANKS], ids=["one bank", "banks"])
def test_a_field_reads_the_numbers_in_use_and_no_others(share, config):
    torch.manual_seed(0)
    network = FieldNetwork(config, 66)
    latents = torch.randn(1, config.latents.dimension, requires_grad=True)
    coordinates = torch.linspace(-1, -1 + 2 * share, 400, dtype=torch.float64)[None]
    network(latents, coordinates, torch.tensor([60.0], dtype=torch.float64)).square().sum().backward()
    assert latents.grad is not None
    used = in_use(first_read(config.latents.dimension, local_latents(config)), torch.tensor([share]))
    np.testing.assert_array_equal(latents.grad[0] != 0, used[0])


def test_a_whole_window_uses_every_number():
    for config in (demo().field, paper().field):
        assert len(first_read(config.latents.dimension, local_latents(config))) == config.latents.dimension
        assert bool(in_use(first_read(config.latents.dimension, local_latents(config)), torch.tensor([1.0])).all())


def test_without_knots_every_number_is_read_at_every_instant():
    assert bool(in_use(first_read(256, local_latents(paper().field)), torch.tensor([0.0, 1e-3])).all())
