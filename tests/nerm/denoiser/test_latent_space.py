"""The diffusion's numbers: paths in steps, shared scales, and back."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motionkit.training.config import apply_overrides
from nerm.denoiser.latent_space import kinds_of_numbers, measured_space, places_of, steps_of
from nerm.latents.local import local_latents
from nerm.latents.posterior import first_read, in_use
from nerm.settings import FieldConfig

CONFIG = apply_overrides(
    FieldConfig(),
    [
        "latents.layout=local",
        f"latents.dimension={8 * 2 + 4 * 3 + 4 * 3}",
        "latents.knots=8,4",
        "latents.knot_numbers=2,3",
        "latents.path_knots=4",
        "loss.scaling=group",
        "loss.root_weight=3.0",
    ],
)
BANKS = local_latents(CONFIG)
assert BANKS is not None


def random_places(seed: int, knots: int = 6) -> torch.Tensor:
    return torch.randn(5, knots, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 3


@given(seed=st.integers(0, 1000))
@settings(max_examples=20)
def test_places_of_undoes_steps_of(seed):
    places = random_places(seed)
    torch.testing.assert_close(places_of(steps_of(places)), places, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(steps_of(places_of(places)), places, rtol=1e-9, atol=1e-9)


@given(seed=st.integers(0, 1000), yaw=st.floats(-3, 3), x=st.floats(-9, 9))
@settings(max_examples=20)
def test_steps_do_not_depend_on_where_a_path_is_and_how_it_lies(seed, yaw, x):
    places = random_places(seed)
    cosine, sine = math.cos(yaw), math.sin(yaw)
    moved = torch.stack(
        (
            cosine * places[..., 0] + sine * places[..., 1] + x,
            cosine * places[..., 1] - sine * places[..., 0] - 2.0,
            places[..., 2] + yaw,
        ),
        dim=-1,
    )
    torch.testing.assert_close(steps_of(moved)[:, 1:], steps_of(places)[:, 1:], rtol=1e-7, atol=1e-7)


def test_walking_round_a_circle_is_a_row_of_equal_steps_forward():
    """Heading 0 is Z+, positive turns towards X+: a body on a circle of radius 2 faces along its tangent."""
    angle = torch.linspace(0, 4, 9, dtype=torch.float64)
    places = torch.stack((2 * (1 - torch.cos(angle)), 2 * torch.sin(angle), angle), dim=-1)[None]
    chord = 2 * 2 * math.sin(0.5 / 2)
    expected = torch.tensor([0.0, chord, 0.5], dtype=torch.float64).expand(8, 3)
    torch.testing.assert_close(steps_of(places)[0, 1:], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("banks", [BANKS, replace(BANKS, path=None), None], ids=["path", "no path", "no knots"])
@pytest.mark.parametrize("path", ["places", "steps"])
@pytest.mark.parametrize("scale", ["number", "component"])
def test_draws_have_mean_0_and_deviation_1_and_come_back(banks, path, scale):
    dimension = 40 if banks is None else banks.dimension
    generator = torch.Generator().manual_seed(0)
    draws = 2 + torch.randn(3000, dimension, generator=generator) * torch.linspace(0.5, 3, dimension)
    used = in_use(first_read(dimension, banks), torch.linspace(0.4, 0.8, 3000))
    space = measured_space(draws, used, banks, path, scale)
    numbers = space.standardise(draws)
    torch.testing.assert_close(space.restore(numbers), draws, rtol=1e-3, atol=1e-3)
    kinds = kinds_of_numbers(dimension, banks, path, scale)
    for kind in range(int(kinds.max()) + 1):
        of_kind = numbers[:, kinds == kind][used[:, kinds == kind]]
        if len(of_kind):
            assert float(of_kind.mean()) == pytest.approx(0, abs=1e-3)
            assert float(of_kind.std()) == pytest.approx(1, abs=1e-3)


def test_numbers_that_nobody_uses_do_not_count():
    """Knots beyond the end hold 1000: neither mean nor deviation notices, and what is never used is left as it is."""
    draws = torch.randn(500, BANKS.dimension, generator=torch.Generator().manual_seed(0))
    first = first_read(BANKS.dimension, BANKS)
    used = in_use(first, torch.full((500,), 0.3))
    space = measured_space(torch.where(used, draws, torch.full_like(draws, 1000.0)), used, BANKS, "places", "number")
    assert float(space.mean.abs().max()) < 0.2
    assert space.deviation[~used[0]].tolist() == [1.0] * int((~used[0]).sum())


def test_components_share_a_scale_over_all_knots():
    kinds = kinds_of_numbers(BANKS.dimension, BANKS, "places", "component")
    assert len(set(kinds.tolist())) == 2 + 3 + 3
    with_start = kinds_of_numbers(BANKS.dimension, BANKS, "steps", "component")
    assert len(set(with_start.tolist())) == 2 + 3 + 3 + 3
    assert torch.bincount(with_start).sort().values.tolist() == [1, 1, 1, 3, 3, 3, 4, 4, 4, 8, 8]
    assert kinds_of_numbers(256, None, "steps", "component").tolist() == list(range(256))
