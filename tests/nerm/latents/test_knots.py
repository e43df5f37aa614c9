import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nerm.latents.knots import Kernel, KnotLayout, mix, ridge_knots

KERNELS: list[Kernel] = ["hann", "lanczos"]
TIMES = torch.linspace(-1, 1, 301, dtype=torch.float64)


@pytest.mark.parametrize("kernel", KERNELS)
def test_constant_knots_read_as_a_constant_up_to_the_ends(kernel: Kernel) -> None:
    weights = KnotLayout(12, kernel, 2.0, 2).interpolant(TIMES)
    torch.testing.assert_close(weights.sum(-1), torch.ones(301, dtype=torch.float64))


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_steady_walk_goes_on_beyond_the_first_and_the_last_knot(kernel: Kernel) -> None:
    layout = KnotLayout(12, kernel, 2.0, 0)
    walked = layout.interpolant(TIMES) @ layout.centres()
    assert float((walked - TIMES).abs().max()) < 0.1 * layout.spacing


def test_lanczos_passes_through_inner_knots_and_hann_does_not() -> None:
    lanczos, hann = (KnotLayout(9, kernel, 2.0, 0) for kernel in ("lanczos", "hann"))  # type: ignore[arg-type]
    torch.testing.assert_close(lanczos.interpolant(lanczos.centres()), torch.eye(9, dtype=torch.float64))
    assert float(hann.interpolant(hann.centres())[4, 4]) == pytest.approx(0.5)


def test_an_instant_sees_the_knots_within_reach() -> None:
    layout = KnotLayout(10, "hann", 2.0, 3)
    basis = layout.basis(TIMES)
    assert basis.shape == (301, 7, 10)
    far = (TIMES[:, None] - layout.centres()).abs() >= 2.0 * layout.spacing
    assert not basis[far[:, None].expand_as(basis)].any()


def test_knots_of_banks_share_stretches_of_time() -> None:
    coarse, fine = (KnotLayout(count, "hann", 2.0, 0).centres() for count in (4, 8))
    torch.testing.assert_close(fine.reshape(4, 2).mean(dim=1), coarse)


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_slope_is_the_interpolant_s_derivative(kernel: Kernel) -> None:
    layout = KnotLayout(7, kernel, 2.0, 0)
    times = TIMES[1:-1].clone().requires_grad_()
    knots = torch.randn(7, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    (derivative,) = torch.autograd.grad((layout.interpolant(times) @ knots).sum(), times)
    torch.testing.assert_close(layout.slope(times.detach()) @ knots / layout.spacing, derivative, atol=1e-4, rtol=1e-4)


@given(st.integers(0, 2**31), st.sampled_from(KERNELS), st.sampled_from([1.0, 2.0]))
def test_ridge_knots_recover_what_knots_made(seed: int, kernel: Kernel, radius: float) -> None:
    layout = KnotLayout(9, kernel, radius, 1)
    knots = torch.randn(2, 9, 3, generator=torch.Generator().manual_seed(seed))
    times = TIMES[::3].repeat(2, 1)
    made = mix(knots, layout.basis(times.reshape(-1)).reshape(2, 101, 3, 9))[..., :3]
    found = ridge_knots(made, times, torch.ones_like(times), layout, 1e-9)
    torch.testing.assert_close(found, knots, atol=2e-3, rtol=2e-3)


def test_lanczos_knots_stay_the_size_of_what_they_hold() -> None:
    wave = torch.sin(2 * math.pi * 3 * TIMES)[None, :, None]
    largest, errors = [], []
    for kernel in KERNELS:
        layout = KnotLayout(16, kernel, 2.0, 0)
        knots = ridge_knots(wave, TIMES[None], torch.ones(1, 301), layout, 0.02)
        largest.append(float(knots.abs().max()))
        errors.append(float((layout.interpolant(TIMES) @ knots[0].double() - wave[0]).square().mean().sqrt()))
    assert largest[1] < 1.2 < 5.0 < largest[0]
    assert max(errors) < 0.3


def test_instants_that_do_not_count_are_not_fitted() -> None:
    layout = KnotLayout(4, "lanczos", 2.0, 0)
    targets = torch.where(TIMES < 0.5, 1.0, 100.0)[None, :, None]
    knots = ridge_knots(targets, TIMES[None], (TIMES < 0.5).double()[None], layout, 1e-9)
    torch.testing.assert_close(knots, torch.ones(1, 4, 1), atol=1e-4, rtol=0)


def test_a_layout_needs_knots_that_meet() -> None:
    with pytest.raises(ValueError, match="at least two knots"):
        KnotLayout(8, "hann", 0.5, 0)
