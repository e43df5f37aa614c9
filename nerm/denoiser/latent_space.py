"""The space that the diffusion works in: standardised latents, with the path as steps.

As positions, a path spreads over metres while its steps are centimetres, so the denoiser's residual noise would be
metres per second of sliding. As steps in the body's frame, a path is as stationary as the poses.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from nerm.latents.local import LocalLatents
from nerm.settings import LatentScale, PathNumbers

SMALLEST_DEVIATION = 1e-6


@dataclass(frozen=True, eq=False)
class LatentSpace:
    """The map between latents of the field and standardised numbers of the same size.

    `banks` is the layout of z (None: global), `path` the representation of its path bank; `mean` and `deviation` are
    those of the numbers in that representation.
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
    """Latents with their path, if any, in the representation `path`."""
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
    """(x, z, heading) of each knot → (sideways, forward, turn) since the knot before; the first knot is unchanged.

    A step is expressed in the heading half-way through it, so that an arc is a sequence of equal steps.
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
    """Groups of numbers of z that share a mean and a deviation, as an index per number.

    With `scale` "component" a group is one component of a bank at all its knots (except the first position of a path
    in steps, which is no step); otherwise, and without banks, each number is its own group.
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
    """The space in which samples of latents have mean 0 and deviation 1, over the motions that use each number.

    A number that no motion uses gets mean 0 and deviation 1.
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
