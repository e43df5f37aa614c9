"""A scalar function applied to many numbers through a table: cubic pieces on an even grid, with exact gradients.

A Fourier-series activation is one scalar function per layer, applied to every neuron of every pose: ζ sines for each of
them cost more than the layer's matrix. Here the sines are those of the grid only, and a number costs one look-up.
"""

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float, Float32

# Value and slope of a function at the points of a grid.
ValueAndSlope = Callable[
    [Float32[torch.Tensor, "points"]], tuple[Float32[torch.Tensor, "points"], Float32[torch.Tensor, "points"]]
]


def apply_by_table(
    function: ValueAndSlope, x: Float[torch.Tensor, "*n"], spacing: float, most_points: int
) -> Float[torch.Tensor, "*n"] | None:
    """function(x) by cubic Hermite pieces between points `spacing` apart; None where x spans more of them than allowed.

    The grid spans the numbers that are there. Gradients are those of the piecewise function: to x by its slope, to what
    the function depends on by summing the incoming gradient onto the pieces.
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
        # Rounding may put the outermost numbers a hair outside.
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
