"""The local latent layout (ours): z's numbers are knots along time; an instant reads a smooth mix of those around it.

Knot k lies at t_k = −1 + 2k / (K − 1). With u = (t − t_k) / spacing, an instant sees, for every mode j,
Σ_k h(u)·e_j(u)·z_k, where h is a Hann bump of the given radius (the bumps sum to one for radius 1, 2, …) and e_j runs
over 1, cos(πju / radius), sin(πju / radius). Nothing else tells it where in the window it lies, so what is learnt at
one time serves at all times.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32, Float64


@dataclass(frozen=True)
class KnotLayout:
    """How `num_knots` knots are spread over [−1, 1] and read: radius in knot spacings, number of cosine-sine modes."""

    num_knots: int
    radius: float
    modes: int

    def __post_init__(self) -> None:
        if self.num_knots < 2 or self.radius < 1.0:
            raise ValueError("a local latent needs two knots or more and a radius of at least one spacing")

    @property
    def spacing(self) -> float:
        """Distance between knots in units of t."""
        return 2.0 / (self.num_knots - 1)

    @property
    def num_basis(self) -> int:
        """Functions per knot: 1 + 2·modes."""
        return 1 + 2 * self.modes

    def basis(self, coordinates: Float64[torch.Tensor, "times"]) -> Float32[torch.Tensor, "times basis knots"]:
        """Weights of all knots at some coordinates, for each basis function; zero outside a knot's radius."""
        knots = torch.arange(self.num_knots, dtype=torch.float64, device=coordinates.device)
        offset = (coordinates[:, None] + 1.0) / self.spacing - knots
        bump = 0.5 * (1.0 + torch.cos(math.pi * offset / self.radius)) * (offset.abs() < self.radius) / self.radius
        angles = [math.pi * mode * offset / self.radius for mode in range(1, self.modes + 1)]
        waves = [wave(angle) for angle in angles for wave in (torch.cos, torch.sin)]
        return torch.stack([bump, *(bump * wave for wave in waves)], dim=1).float()


def mix(
    knots: Float[torch.Tensor, "batch knots width"], basis: Float[torch.Tensor, "batch poses basis knots"]
) -> Float[torch.Tensor, "batch poses mixed"]:
    """What each pose of each clip reads: its basis applied to its clip's knots, [batch, poses, basis · width]."""
    batch, poses, functions, num_knots = basis.shape
    mixed = torch.bmm(basis.reshape(batch, poses * functions, num_knots), knots)
    return mixed.reshape(batch, poses, functions * knots.shape[-1])


def ridge_knots(
    targets: Float[torch.Tensor, "windows times width"],
    coordinates: Float64[torch.Tensor, "windows times"],
    layout: KnotLayout,
    ridge: float,
) -> Float32[torch.Tensor, "windows knots width"]:
    """Knots whose plain Hann mix comes closest to targets at given coordinates: ridge regression."""
    shape = coordinates.shape
    weights = layout.basis(coordinates.reshape(-1))[:, 0].reshape(*shape, layout.num_knots).double()
    gram = weights.transpose(1, 2) @ weights + ridge * torch.eye(layout.num_knots, dtype=torch.float64)
    knots: torch.Tensor = torch.linalg.solve(gram, weights.transpose(1, 2) @ targets.double())
    return knots.float()
