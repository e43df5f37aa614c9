"""The grid that every stored number lies on: finer digits of float32 are noise, and noise does not compress."""

import numpy as np
from jaxtyping import Float32

# 2^-22: 0.24 micrometres, or half a microradian of a quaternion's turn. It is the spacing of float32 itself from 2 to
# 4 metres from the origin, so no coordinate loses what it would have kept a few steps further away.
RESOLUTION_BITS = 22
_SCALE = np.float32(2.0**RESOLUTION_BITS)
# What this times the scale would be beyond float32; far from all bodies.
_TOO_LARGE = np.float32(2.0**100)


def rounded(values: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """Each number as the nearest multiple of 2^-22, ties to even; from 2 on float32 holds nothing finer anyway."""
    if not values.size or not (values.min() > -_TOO_LARGE and values.max() < _TOO_LARGE):
        inside = np.where(np.abs(values) < _TOO_LARGE, values, np.float32(0))
        return np.where(inside == values, rounded(inside), values) if values.size else values
    # Scaling by a power of two is exact, and from 2 on the scaled number is whole.
    on_grid: Float32[np.ndarray, "*shape"] = values * _SCALE
    np.rint(on_grid, out=on_grid)
    on_grid /= _SCALE
    return on_grid
