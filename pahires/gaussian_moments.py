"""Moments of σ(x) = Σ Ψ_i sin(Ω_i x + Φ_i) under x ~ N(0, 1), in closed form.

With E sin(ωx + φ) = sin φ · e^{−ω²/2} and products of sines as sums of cosines, all that an initialisation needs of a
Fourier-series activation is a double sum over its terms.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float64


@dataclass(frozen=True)
class GaussianMoments:
    """Mean and variance of σ(x), and the mean square of its slope σ′(x)."""

    mean: float
    variance: float
    slope_square: float


def gaussian_moments(
    amplitudes: Float64[torch.Tensor, "sines"],
    frequencies: Float64[torch.Tensor, "sines"],
    phases: Float64[torch.Tensor, "sines"],
) -> GaussianMoments:
    """The moments of Σ Ψ_i sin(Ω_i x + Φ_i) for standard normal x."""
    apart, together = frequencies[:, None] - frequencies, frequencies[:, None] + frequencies
    difference = torch.cos(phases[:, None] - phases) * torch.exp(-apart.square() / 2)
    total = torch.cos(phases[:, None] + phases) * torch.exp(-together.square() / 2)
    pairs = amplitudes[:, None] * amplitudes
    mean = torch.sum(amplitudes * torch.sin(phases) * torch.exp(-frequencies.square() / 2))
    square = 0.5 * torch.sum(pairs * (difference - total))
    slopes = 0.5 * torch.sum(pairs * frequencies[:, None] * frequencies * (difference + total))
    return GaussianMoments(float(mean), float(square - mean.square()), float(slopes))
