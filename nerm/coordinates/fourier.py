"""From seconds to what a network reads: coordinates t, the framerate, Fourier features (paper §3.1)."""

import math

import torch
from jaxtyping import Float, Float32, Float64, Int64
from torch import nn

REFERENCE_FPS = 20.0


def framerate_number(fps: Float64[torch.Tensor, "*shape"], scale: float) -> Float32[torch.Tensor, "*shape"]:
    """The framerate s as the network reads it: scale · log₂(s / 20)."""
    return (scale * torch.log2(fps / REFERENCE_FPS)).float()


def frame_numbers(
    coordinates: Float64[torch.Tensor, "batch poses"],
    fps: Float64[torch.Tensor, "batch"],
    max_duration_seconds: float,
) -> Float64[torch.Tensor, "batch poses"]:
    """Normalised coordinates → frame numbers 1 … T at each clip's own framerate: Table 9's alternative."""
    return (coordinates + 1.0) * (0.5 * max_duration_seconds) * fps[:, None] + 1.0


def distinct(
    values: Float64[torch.Tensor, "*shape"],
) -> tuple[Float64[torch.Tensor, "distinct"], Int64[torch.Tensor, "*shape"]]:
    """The distinct values and, for every place, which of them it holds.

    Values are rounded to 2⁻⁴⁰ first, so that one instant reached through two framerates counts once.
    """
    rounded = torch.round(values * 2.0**40) / 2.0**40
    unique, inverse = torch.unique(rounded, return_inverse=True)
    return unique, inverse


def rounded_up(values: Float64[torch.Tensor, "distinct"]) -> Float64[torch.Tensor, "padded"]:
    """The values, the last one repeated until there are m · 2ⁿ of them with m ≤ 16: at most an eighth more.

    How many distinct coordinates a batch has differs from step to step, the more the higher the framerates, and
    libraries keep what they prepare for each shape of a matrix: few shapes make a step's memory the same at all rates.
    """
    count = len(values)
    step = 1 << max(0, (count - 1).bit_length() - 4)
    return torch.cat((values, values[-1:].expand(-count % step)))


class FourierFeatures(nn.Module):
    """γ(t) = [cos 2πb₁t, sin 2πb₁t, …] with b_r from an isotropic Gaussian (Tancik et al. 2020).

    With `period` (in units of t) the frequencies are whole multiples of 1 / period, so that γ repeats without a seam.
    """

    frequencies: torch.Tensor

    def __init__(self, num_frequencies: int, scale: float, period: float | None = None) -> None:
        super().__init__()
        frequencies = torch.randn(num_frequencies, dtype=torch.float64) * scale
        if period is not None:
            frequencies = torch.clamp(torch.round(frequencies.abs() * period), min=1.0) / period
        self.register_buffer("frequencies", frequencies)

    @property
    def width(self) -> int:
        """Numbers per coordinate: 2·R."""
        return 2 * len(self.frequencies)

    def forward(self, coordinates: Float64[torch.Tensor, "*shape"]) -> Float[torch.Tensor, "*shape width"]:
        """Features of coordinates; angles in float64, features in float32."""
        angles = 2.0 * math.pi * coordinates[..., None] * self.frequencies
        return torch.stack((torch.cos(angles), torch.sin(angles)), dim=-1).flatten(-2).float()
