"""The parametric activation σ(x) = Σ Ψ_i sin(Ω_i x + Φ_i) (Eq. 4), its initialisations, and layers that have it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch

from motionkit.core.shapes import Float, Float32, Float64
from pahires.recipes import Initialisation


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


# Value and slope of a function at the points of a grid.
ValueAndSlope = Callable[
    [Float32[torch.Tensor, "points"]], tuple[Float32[torch.Tensor, "points"], Float32[torch.Tensor, "points"]]
]


def apply_by_table(
    function: ValueAndSlope, x: Float[torch.Tensor, "*n"], spacing: float, most_points: int
) -> Float[torch.Tensor, "*n"] | None:
    """function(x) by cubic Hermite interpolation on a grid of this spacing; None if x spans more than allowed.

    The grid spans the values of x. Gradients are those of the interpolant: with respect to x its slope, with respect to
    the function's parameters by summing the incoming gradient onto the pieces.
    """
    lowest, highest = (float(end) for end in torch.aminmax(x.detach())) if x.numel() else (0.0, 0.0)
    points = (highest - lowest) / spacing + 3
    if not points <= most_points:
        return None
    start = lowest - 0.5 * spacing
    value, slope = function(start + spacing * torch.arange(int(points), dtype=torch.float32, device=x.device))
    slope = spacing * slope
    step = value.diff()
    pieces = torch.stack(
        (value[:-1], slope[:-1], 3 * step - 2 * slope[:-1] - slope[1:], slope[:-1] + slope[1:] - 2 * step), dim=1
    )
    result: torch.Tensor = _PiecewiseCubic.apply(x, pieces, start, spacing)  # type: ignore[no-untyped-call]
    return result


class _PiecewiseCubic(torch.autograd.Function):
    """Σ_k pieces[i, k]·uᵏ with i and u the whole and the fractional part of (x − start) / spacing."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, pieces: torch.Tensor, start: float, spacing: float) -> torch.Tensor:
        place = ((x.float() - start) / spacing).flatten()
        # Rounding may put the outermost values just outside.
        piece = place.to(torch.int32).clamp_(0, len(pieces) - 1)
        u = place.sub_(piece)
        c0, c1, c2, c3 = pieces.index_select(0, piece).unbind(1)
        value = torch.addcmul(c2, c3, u)
        value = torch.addcmul(c1, value, u)
        value = torch.addcmul(c0, value, u)
        slope = torch.addcmul(c2, c3, u, value=1.5).mul_(u).mul_(2.0).add_(c1).mul_(1.0 / spacing)
        ctx.save_for_backward(slope, piece, u)
        ctx.num_pieces = len(pieces)
        return value.view(x.shape).to(x.dtype)

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None, None, None]:
        slope, piece, u = ctx.saved_tensors
        incoming = gradients[0].float().flatten()
        to_x = (slope * incoming).view(gradients[0].shape).to(gradients[0].dtype)
        if not ctx.needs_input_grad[1]:
            return to_x, None, None, None
        sums = []
        for power in range(4):
            if power:
                incoming = incoming * u
            sums.append(torch.bincount(piece, incoming, minlength=ctx.num_pieces))
        return to_x, torch.stack(sums, dim=1).float(), None, None


# E σ′² of SIREN's sin(√2 …) layers under unit variance (spec: the value that keeps gradients over layers).
SLOPE_SQUARE = 1.3
# Most random initialisations reach that slope with slow sines of amplitudes up to 1e5 that nearly cancel, so any
# optimiser step changes the function wildly. A quarter of all draws stay below this amplitude at unit variance.
LARGEST_AMPLITUDE = 3.0
_POINTS_PER_RADIAN = 4.0
_MOST_POINTS = 1 << 15
_FEWEST_NUMBERS = 4096


class FourierActivation(torch.nn.Module):
    """An elementwise activation with ζ learnable amplitudes, frequencies and phases.

    `offset` is its mean under N(0, 1) at initialisation, subtracted so that layers start centred; it is not learnt.
    """

    offset: torch.Tensor

    def __init__(self, num_sines: int, initialisation: Initialisation) -> None:
        super().__init__()
        amplitudes, frequencies, phases, offset = {
            "calibrated": _calibrated,
            "staf": _staf,
            "siren": _siren,
        }[initialisation](num_sines)
        self.amplitudes = torch.nn.Parameter(amplitudes.float())
        self.frequencies = torch.nn.Parameter(frequencies.float())
        self.phases = torch.nn.Parameter(phases.float())
        self.register_buffer("offset", torch.tensor(offset, dtype=torch.float32))

    def forward(self, x: Float[torch.Tensor, "*n"]) -> Float[torch.Tensor, "*n"]:
        """σ elementwise; by interpolation for large inputs on a CPU."""
        if x.numel() >= _FEWEST_NUMBERS and x.device.type == "cpu":
            fastest = max(1.0, float(self.frequencies.detach().abs().max()))
            looked_up = apply_by_table(self.value_and_slope, x, 1.0 / (_POINTS_PER_RADIAN * fastest), _MOST_POINTS)
            if looked_up is not None:
                return looked_up
        return self.direct(x)

    def direct(self, x: Float[torch.Tensor, "*n"]) -> Float[torch.Tensor, "*n"]:
        """σ by its definition, with ζ sines per element."""
        total = -self.offset
        for amplitude, frequency, phase in zip(self.amplitudes, self.frequencies, self.phases, strict=True):
            total = total + amplitude * torch.sin(frequency * x + phase)
        return total

    def value_and_slope(
        self, x: Float32[torch.Tensor, "points"]
    ) -> tuple[Float32[torch.Tensor, "points"], Float32[torch.Tensor, "points"]]:
        """σ and σ′ at these points."""
        angle = x[:, None] * self.frequencies + self.phases
        value = torch.sin(angle) @ self.amplitudes - self.offset
        return value, torch.cos(angle) @ (self.amplitudes * self.frequencies)


_Start = tuple[Float64[torch.Tensor, "sines"], Float64[torch.Tensor, "sines"], Float64[torch.Tensor, "sines"], float]


def _calibrated(num_sines: int) -> _Start:
    """Ω = c·geomspace(¼, 8), Ψ = ± Rayleigh(1) / Ω, Φ ~ U(−π, π); unit variance, and c by bisection for the slope.

    Draws whose amplitudes nearly cancel are drawn again (`LARGEST_AMPLITUDE`).
    """
    spread = torch.logspace(-2.0, 3.0, num_sines, base=2.0, dtype=torch.float64)
    while True:
        signs = torch.randint(0, 2, (num_sines,)).double() * 2 - 1
        heights = signs * torch.sqrt(-2 * torch.log1p(-torch.rand(num_sines, dtype=torch.float64)))
        phases = math.pi * (2 * torch.rand(num_sines, dtype=torch.float64) - 1)
        frequencies = _slope_factor(heights, spread, phases) * spread
        moments = gaussian_moments(heights / frequencies, frequencies, phases)
        amplitudes = heights / frequencies / math.sqrt(moments.variance)
        if float(amplitudes.abs().max()) <= LARGEST_AMPLITUDE:
            return amplitudes, frequencies, phases, moments.mean / math.sqrt(moments.variance)


def _slope_factor(
    heights: Float64[torch.Tensor, "sines"],
    spread: Float64[torch.Tensor, "sines"],
    phases: Float64[torch.Tensor, "sines"],
) -> float:
    """c of Ω = c · `spread`, at which E σ′² is `SLOPE_SQUARE` times the variance."""

    def slope_square(factor: float) -> float:
        moments = gaussian_moments(heights / (factor * spread), factor * spread, phases)
        return moments.slope_square / moments.variance

    low, high = 1e-3, 1e3
    for _ in range(50):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if slope_square(middle) < SLOPE_SQUARE else (low, middle)
    return low


def _staf(num_sines: int) -> _Start:
    """STAF's initialisation: Ω = 30·U(0, 1), Φ ~ U(−π, π), |Ψ|² ~ Laplace of b = 1 / (2ζ) (arXiv 2502.00869)."""
    laplace = torch.distributions.Laplace(0.0, 1 / (2 * num_sines)).sample((num_sines,)).double()
    amplitudes = laplace.sign() * laplace.abs().sqrt()
    phases = math.pi * (2 * torch.rand(num_sines, dtype=torch.float64) - 1)
    return amplitudes, 30 * torch.rand(num_sines, dtype=torch.float64), phases, 0.0


def _siren(num_sines: int) -> _Start:
    """sin(x) as the first term; the others start with zero amplitude."""
    amplitudes = torch.zeros(num_sines, dtype=torch.float64)
    amplitudes[0] = 1.0
    frequencies = torch.cat((torch.ones(1, dtype=torch.float64), torch.linspace(0.5, 8.0, num_sines - 1).double()))
    return amplitudes, frequencies, torch.zeros(num_sines, dtype=torch.float64), 0.0


def linear(inputs: int, outputs: int, initialisation: Initialisation) -> torch.nn.Linear:
    """A layer before an activation: weights U(±√(3 / n)), for SIREN U(±√(6 / n)); biases 0, or SIREN's U(±1 / √n)."""
    layer = torch.nn.Linear(inputs, outputs)
    bound = math.sqrt((6 if initialisation == "siren" else 3) / inputs)
    torch.nn.init.uniform_(layer.weight, -bound, bound)
    if initialisation == "siren":
        torch.nn.init.uniform_(layer.bias, -1 / math.sqrt(inputs), 1 / math.sqrt(inputs))
    else:
        torch.nn.init.zeros_(layer.bias)
    return layer
