"""Knots along time, and the basis functions that interpolate between them.

K knots divide [−1, 1] evenly: knot k is the centre t_k = −1 + (2k + 1) / K of its segment, so that segments of a bank
of 16 align with those of a bank of 32. With u_k = (t − t_k) / spacing, an instant reads Σ_k e_j(u_k)·z_k for every mode
j. Mode 0 is an interpolant: a Hann window, or Lanczos' windowed sinc, which passes through the knots and keeps more of
the band below their Nyquist rate; both are scaled to sum to one. The others are a Hann window times cos(πju / radius)
and sin(πju / radius). Nothing else depends on the absolute time, so the network is shift-invariant.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from motionkit.core.shapes import Float, Float32, Float64
from motionkit.features import field

Kernel = Literal["hann", "lanczos"]
LANCZOS_RADIUS = 3.0


@dataclass(frozen=True)
class KnotLayout:
    """Basis functions of `num_knots` knots: the interpolant, the radius of windows in knot spacings, and the modes."""

    num_knots: int
    kernel: Kernel
    radius: float
    modes: int

    def __post_init__(self) -> None:
        if self.num_knots < 2 or self.radius < 1.0:
            raise ValueError("a local latent needs at least two knots and a radius of at least one spacing")

    @property
    def spacing(self) -> float:
        """Distance between knots in units of t."""
        return 2.0 / self.num_knots

    @property
    def num_basis(self) -> int:
        """Functions per knot: 1 + 2·modes."""
        return 1 + 2 * self.modes

    @property
    def reach(self) -> float:
        """Support radius of a knot's basis functions, in knot spacings."""
        of_kernel = LANCZOS_RADIUS if self.kernel == "lanczos" else self.radius
        return max(of_kernel, self.radius) if self.modes else of_kernel

    def centres(self) -> Float64[torch.Tensor, "knots"]:
        """Positions of the knots in [−1, 1]."""
        return -1.0 + (torch.arange(self.num_knots, dtype=torch.float64) + 0.5) * self.spacing

    def interpolant(self, coordinates: Float64[torch.Tensor, "times"]) -> Float64[torch.Tensor, "times knots"]:
        """Weights of mode 0, which sum to one at each time.

        In the half spacing before the first knot and after the last, knots are extrapolated linearly.
        """
        outside = math.ceil(LANCZOS_RADIUS)
        offset = self._offset(coordinates, outside)
        if self.kernel == "hann":
            weights = _hann(offset, self.radius)
        else:
            inside = offset.abs() < LANCZOS_RADIUS
            weights = torch.sinc(offset) * torch.sinc(offset / LANCZOS_RADIUS) * inside
        weights = weights / weights.sum(dim=1, keepdim=True)
        before, own, after = weights.tensor_split((outside, outside + self.num_knots), dim=1)
        distance = torch.arange(1, outside + 1, dtype=torch.float64, device=weights.device)
        own[:, 0] += before.flip(1) @ (1.0 + distance)
        own[:, 1] -= before.flip(1) @ distance
        own[:, -1] += after @ (1.0 + distance)
        own[:, -2] -= after @ distance
        return own

    def slope(self, coordinates: Float64[torch.Tensor, "times"]) -> Float64[torch.Tensor, "times knots"]:
        """The interpolant's derivative, per knot spacing (by central differences)."""
        step = 1e-4 * self.spacing
        return (self.interpolant(coordinates + step) - self.interpolant(coordinates - step)) / 2e-4

    def basis(self, coordinates: Float64[torch.Tensor, "times"]) -> Float32[torch.Tensor, "times basis knots"]:
        """Weights of all knots at some coordinates, for each mode; zero outside a knot's reach."""
        offset = self._offset(coordinates)
        bump = _hann(offset, self.radius)
        angles = [math.pi * mode * offset / self.radius for mode in range(1, self.modes + 1)]
        waves = [bump * wave(angle) for angle in angles for wave in (torch.cos, torch.sin)]
        return torch.stack([self.interpolant(coordinates), *waves], dim=1).float()

    def _offset(
        self, coordinates: Float64[torch.Tensor, "times"], outside: int = 0
    ) -> Float64[torch.Tensor, "times offsets"]:
        """Distances in knot spacings from all knots, and from as many beyond either end."""
        knots = torch.arange(-outside, self.num_knots + outside, dtype=torch.float64, device=coordinates.device)
        return (coordinates[:, None] + 1.0) / self.spacing - (knots + 0.5)


def _hann(offset: Float64[torch.Tensor, "times offsets"], radius: float) -> Float64[torch.Tensor, "times offsets"]:
    """A Hann window of unit area."""
    return 0.5 * (1.0 + torch.cos(math.pi * offset / radius)) * (offset.abs() < radius) / radius


def mix(
    knots: Float[torch.Tensor, "batch knots width"], basis: Float[torch.Tensor, "batch poses basis knots"]
) -> Float[torch.Tensor, "batch poses mixed"]:
    """Apply each pose's basis weights to its clip's knots: [batch, poses, basis · width]."""
    batch, poses, functions, num_knots = basis.shape
    mixed = torch.bmm(basis.reshape(batch, poses * functions, num_knots), knots)
    return mixed.reshape(batch, poses, functions * knots.shape[-1])


def ridge_knots(
    targets: Float[torch.Tensor, "windows times width"],
    coordinates: Float64[torch.Tensor, "windows times"],
    counts: Float[torch.Tensor, "windows times"],
    layout: KnotLayout,
    ridge: float,
) -> Float32[torch.Tensor, "windows knots width"]:
    """Fit knots to targets at given coordinates by ridge regression.

    `counts` weights the instants; the ridge is in units of one instant.
    """
    weights = layout.interpolant(coordinates.reshape(-1)).reshape(*coordinates.shape, layout.num_knots)
    counted = (weights * counts[..., None]).transpose(1, 2)
    gram = counted @ weights + ridge * torch.eye(layout.num_knots, dtype=torch.float64)
    knots: torch.Tensor = torch.linalg.solve(gram, counted @ targets.double())
    return knots.float()


NUM_PATH_NUMBERS = 3


def turned(
    vectors: Float[torch.Tensor, "*poses numbers"], yaw: Float[torch.Tensor, "*poses"]
) -> Float[torch.Tensor, "*poses numbers"]:
    """Rotate `field` vectors about the vertical by radians (positive from Z+ towards X+), root position included."""
    cosine, sine = torch.cos(yaw)[..., None], torch.sin(yaw)[..., None]
    x, y, z = vectors.reshape(*vectors.shape[:-1], vectors.shape[-1] // 3, 3).unbind(-1)
    return torch.stack((cosine * x + sine * z, y, cosine * z - sine * x), dim=-1).flatten(-2)


def placed(
    relative: Float[torch.Tensor, "*poses numbers"], path: Float[torch.Tensor, "*poses 3"]
) -> Float[torch.Tensor, "*poses numbers"]:
    """Poses relative to a path → `field` vectors in the window's frame."""
    return _moved(turned(relative, path[..., 2]), path, 1.0)


def relative_to(
    vectors: Float[torch.Tensor, "*poses numbers"], path: Float[torch.Tensor, "*poses 3"]
) -> Float[torch.Tensor, "*poses numbers"]:
    """`field` vectors in the window's frame → poses relative to a path; the inverse of `placed`."""
    return turned(_moved(vectors, path, -1.0), -path[..., 2])


def path_speed(
    slope: Float[torch.Tensor, "*poses 3"], path: Float[torch.Tensor, "*poses 3"]
) -> Float[torch.Tensor, "*poses 3"]:
    """The path's velocity in the body's frame: sideways, forward, turning."""
    cosine, sine = torch.cos(path[..., 2]), torch.sin(path[..., 2])
    x, z, turning = slope.unbind(-1)
    return torch.stack((cosine * x - sine * z, sine * x + cosine * z, turning), dim=-1)


def measured_heading(
    vectors: Float32[torch.Tensor, "windows times numbers"],
) -> Float64[torch.Tensor, "windows times"]:
    """The unwrapped heading (radians) of `field` vectors in metres and in order of time."""
    heading = field.heading(field.decode(vectors.numpy())).astype(np.float64)
    return torch.from_numpy(np.unwrap(heading, axis=1))


def _moved(
    vectors: Float[torch.Tensor, "*poses numbers"], path: Float[torch.Tensor, "*poses 3"], sign: float
) -> Float[torch.Tensor, "*poses numbers"]:
    x, height, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    root = torch.stack((x + sign * path[..., 0], height, z + sign * path[..., 1]), dim=-1)
    return torch.cat((root, vectors[..., 3:]), dim=-1)
