"""How latents are laid out along time, read, fitted and standardised."""

from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motionkit.data.windows import FrameValues, WindowPoses, cut_windows
from motionkit.features.field import FIELD_VECTORS
from motionkit.store.cache import PositionCache
from motionkit.training.networks import measure_scaling
from nerm.latents import (
    Bank,
    LocalLatents,
    first_read,
    in_use,
    kinds_of_numbers,
    linear_model,
    local_latents,
    measured_space,
    mix,
    placed,
    places_of,
    ridge_knots,
    steps_of,
)
from nerm.network import FieldNetwork
from nerm.recipes import FieldConfig
from tests.helpers.nerm_corpus import analytic_positions, corpus_in_memory
from tests.nerm.small_fields import changed

TIMES = torch.linspace(-1, 1, 301, dtype=torch.float64)


def test_the_slope_is_the_interpolant_s_derivative() -> None:
    layout = Bank(7, 1)
    times = TIMES[1:-1].clone().requires_grad_()
    knots = torch.randn(7, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    (derivative,) = torch.autograd.grad((layout.interpolant(times) @ knots).sum(), times)
    torch.testing.assert_close(layout.slope(times.detach()) @ knots / layout.spacing, derivative, atol=1e-4, rtol=1e-4)


@given(st.integers(0, 2**31))
def test_ridge_knots_recover_what_knots_made(seed: int) -> None:
    layout = Bank(9, 3)
    knots = torch.randn(2, 9, 3, generator=torch.Generator().manual_seed(seed))
    times = TIMES[::3].repeat(2, 1)
    made = mix(knots, layout.basis(times.reshape(-1)).reshape(2, 101, 7, 9))[..., :3]
    found = ridge_knots(made, times, torch.ones_like(times), layout, 1e-9)
    torch.testing.assert_close(found, knots, atol=2e-3, rtol=2e-3)


def _poses(source: PositionCache, seconds: float = 4.0) -> WindowPoses:
    return WindowPoses(cut_windows(source, max_duration_seconds=seconds), FrameValues(source.positions, FIELD_VECTORS))


def _circling(seconds: float = 4.0, fps: int = 60) -> PositionCache:
    """The first analytic motion, once at 1.2 m/s around a circle that it closes 1.3 times, always facing ahead."""
    times = np.arange(int(seconds * fps) + 1) / fps
    heading = 2 * np.pi * 1.3 * times / seconds
    body = analytic_positions(times, 0).astype(np.float64)
    body[..., 2] -= 0.5 * times[:, None]
    x, z = body[..., 0].copy(), body[..., 2].copy()
    cosine, sine = np.cos(heading)[:, None], np.sin(heading)[:, None]
    radius = 1.2 * seconds / (2 * np.pi * 1.3)
    body[..., 0] = cosine * x + sine * z + radius * (1 - np.cos(heading))[:, None]
    body[..., 2] = cosine * z - sine * x + radius * np.sin(heading)[:, None]
    return corpus_in_memory([body], [Fraction(fps)])


def test_the_linear_model_describes_somebody_who_walks_in_circles() -> None:
    poses = _poses(_circling())
    banks = LocalLatents((Bank(16, 6), Bank(8, 5)), Bank(8, 3), 4.0)
    scaling = measure_scaling(poses, grouped=True, root_weight=4.0, centred_path=True)
    coordinates, vectors = (
        torch.from_numpy(getattr(poses.evenly(np.array([0]), 128), name)) for name in ("coordinates", "vectors")
    )
    model = linear_model([(coordinates, vectors)], scaling, banks)
    weights = banks.weights(coordinates.reshape(-1))
    inputs, path = banks.read(model.fit(coordinates, vectors), weights, torch.arange(128)[None])
    poses_on_path = inputs[..., : banks.num_components] @ model.inverse() + model.mean
    found = scaling.invert(placed(poses_on_path, path))
    # Lengths of 66 numbers, in metres: 4 cm over 22 joints.
    assert float((found - vectors).norm(dim=-1).mean()) < 0.4


TINY = "latents.layout=local loss.scaling=group decoder.width=16 decoder.num_layers=2 encoder.kind=none "
ONE_BANK = changed(FieldConfig(), TINY + "latents.knots=8 latents.knot_numbers=4 latents.path_knots=8")
TWO_BANKS = changed(FieldConfig(), TINY + "latents.knots=16,8 latents.knot_numbers=2,3 latents.path_knots=8")


@pytest.mark.parametrize("share", [0.05, 0.31, 1.0])
@pytest.mark.parametrize("config", [ONE_BANK, TWO_BANKS], ids=["one bank", "banks"])
def test_a_field_reads_the_numbers_in_use_and_no_others(share: float, config: FieldConfig) -> None:
    torch.manual_seed(0)
    network = FieldNetwork(config, 66)
    banks = local_latents(config)
    assert banks is not None
    latents = torch.randn(1, banks.dimension, requires_grad=True)
    coordinates = torch.linspace(-1, -1 + 2 * share, 400, dtype=torch.float64)[None]
    network(latents, coordinates, torch.tensor([60.0], dtype=torch.float64)).square().sum().backward()
    assert latents.grad is not None
    used = in_use(first_read(banks.dimension, banks), torch.tensor([share]))
    np.testing.assert_array_equal(latents.grad[0] != 0, used[0])


BANKS = LocalLatents((Bank(8, 2), Bank(4, 3)), Bank(4, 3), 3.0)


def random_places(seed: int, knots: int = 6) -> torch.Tensor:
    return torch.randn(5, knots, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 3


@given(seed=st.integers(0, 1000))
@settings(max_examples=20)
def test_places_of_undoes_steps_of(seed: int) -> None:
    places = random_places(seed)
    torch.testing.assert_close(places_of(steps_of(places)), places, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(steps_of(places_of(places)), places, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("banks", [BANKS, None], ids=["local", "global"])
def test_draws_have_mean_0_and_deviation_1_and_come_back(banks: LocalLatents | None) -> None:
    dimension = 40 if banks is None else banks.dimension
    generator = torch.Generator().manual_seed(0)
    draws = 2 + torch.randn(3000, dimension, generator=generator) * torch.linspace(0.5, 3, dimension)
    used = in_use(first_read(dimension, banks), torch.linspace(0.4, 0.8, 3000))
    space = measured_space(draws, used, banks)
    numbers = space.standardise(draws)
    torch.testing.assert_close(space.restore(numbers), draws, rtol=1e-3, atol=1e-3)
    kinds = kinds_of_numbers(dimension, banks)
    for kind in range(int(kinds.max()) + 1):
        of_kind = numbers[:, kinds == kind][used[:, kinds == kind]]
        if len(of_kind):
            assert float(of_kind.mean()) == pytest.approx(0, abs=1e-3)
            assert float(of_kind.std()) == pytest.approx(1, abs=1e-3)
