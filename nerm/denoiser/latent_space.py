"""The numbers that the diffusion works on, made from the field's latents and back.

A path in places spreads over metres while a step of it is centimetres, so what a denoiser leaves of the noise would be
metres a second of sliding. In steps, seen by the body that takes them, a path is as stationary as the poses are.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Float32, Float64, Int64
from torch import Tensor

from nerm.latents.local import LocalLatents
from nerm.settings import LatentScale, PathNumbers

SMALLEST_DEVIATION = 1e-6


@dataclass(frozen=True, eq=False)
class LatentSpace:
    """The map between latents of the field and standardised numbers, one for each number of z.

    `banks` says what z is made of (None for the layout global), `path` how its path bank is written, `mean` and
    `deviation` belong to the numbers as written.
    """

    banks: LocalLatents | None
    path: PathNumbers
    mean: Float32[Tensor, "latent"]
    deviation: Float32[Tensor, "latent"]

    def standardise(self, latents: Float32[Tensor, "batch latent"]) -> Float32[Tensor, "batch latent"]:
        """Latents of the field → numbers of the diffusion."""
        return (written(latents, self.banks, self.path) - self.mean) / self.deviation

    def restore(self, numbers: Float32[Tensor, "batch latent"]) -> Float32[Tensor, "batch latent"]:
        """The inverse of `standardise`."""
        return read(numbers * self.deviation + self.mean, self.banks, self.path)


def written(
    latents: Float32[Tensor, "batch latent"], banks: LocalLatents | None, path: PathNumbers
) -> Float32[Tensor, "batch latent"]:
    """Latents with their path, if they have one, in the numbers that `path` names."""
    if path == "places" or banks is None or banks.path is None:
        return latents
    *poses, places = banks.split(latents)
    return banks.join([*poses, steps_of(places)])


def read(
    numbers: Float32[Tensor, "batch latent"], banks: LocalLatents | None, path: PathNumbers
) -> Float32[Tensor, "batch latent"]:
    """The inverse of `written`."""
    if path == "places" or banks is None or banks.path is None:
        return numbers
    *poses, steps = banks.split(numbers)
    return banks.join([*poses, places_of(steps)])


def steps_of(places: Float[Tensor, "batch knots 3"]) -> Float[Tensor, "batch knots 3"]:
    """(x, z, heading) of each knot → (sideways, forward, turn) since the knot before; the first knot stays as it is.

    A step is seen from the heading half-way through it, so that an arc is a row of equal steps.
    """
    change = places[:, 1:] - places[:, :-1]
    half_way = 0.5 * (places[:, 1:, 2] + places[:, :-1, 2])
    x, z, turn = change.unbind(-1)
    cosine, sine = torch.cos(half_way), torch.sin(half_way)
    steps = torch.stack((cosine * x - sine * z, sine * x + cosine * z, turn), dim=-1)
    return torch.cat((places[:, :1], steps), dim=1)


def places_of(steps: Float[Tensor, "batch knots 3"]) -> Float[Tensor, "batch knots 3"]:
    """The inverse of `steps_of`."""
    heading = steps[..., 2].cumsum(dim=1)
    half_way = heading[:, 1:] - 0.5 * steps[:, 1:, 2]
    cosine, sine = torch.cos(half_way), torch.sin(half_way)
    sideways, forward, _ = steps[:, 1:].unbind(-1)
    change = torch.stack((cosine * sideways + sine * forward, cosine * forward - sine * sideways), dim=-1)
    path = torch.cat((steps[:, :1, :2], change), dim=1).cumsum(dim=1)
    return torch.cat((path, heading[..., None]), dim=-1)


def kinds_of_numbers(
    dimension: int, banks: LocalLatents | None, path: PathNumbers, scale: LatentScale
) -> Int64[Tensor, "latent"]:
    """Which numbers of z share a mean and a deviation: those of one kind have the same index.

    With `scale` "component" these are one component of a bank at all its knots (but the first place of a path in steps,
    which is no step); otherwise, and without banks, each number is a kind of its own.
    """
    if banks is None or scale == "number":
        return torch.arange(dimension)
    numbers = banks.describe()
    is_path = (numbers.bank == len(banks.pose)) & (banks.path is not None)
    is_start = is_path & (numbers.knot == 0) & (path == "steps")
    names = torch.stack((numbers.bank, numbers.component, is_start.to(torch.int64)))
    kinds: Tensor = torch.unique(names, dim=1, return_inverse=True)[1]
    return kinds


def measured_space(
    latents: Float32[Tensor, "draws latent"],
    used: Bool[Tensor, "draws latent"],
    banks: LocalLatents | None,
    path: PathNumbers,
    scale: LatentScale,
) -> LatentSpace:
    """The space in which draws of latents have mean 0 and deviation 1, where their motions depend on a number.

    A number that no motion depends on gets mean 0 and deviation 1.
    """
    numbers, share = written(latents, banks, path).to(torch.float64), used.to(torch.float64)
    kinds = kinds_of_numbers(latents.shape[1], banks, path, scale)

    def over_kinds(sums: Float64[Tensor, "latent"]) -> Float64[Tensor, "latent"]:
        return torch.zeros(int(kinds.max()) + 1, dtype=torch.float64).index_add(0, kinds, sums)[kinds]

    counts = over_kinds(share.sum(dim=0))
    mean = over_kinds((numbers * share).sum(dim=0)) / counts.clamp(min=1)
    variance = over_kinds(((numbers - mean).square() * share).sum(dim=0)) / counts.clamp(min=1)
    deviation = torch.where(counts > 0, variance.sqrt().clamp(min=SMALLEST_DEVIATION), torch.ones_like(variance))
    return LatentSpace(banks, path, mean.to(torch.float32), deviation.to(torch.float32))
