"""The local layout of z (ours): banks of knots along time, each number at an instant.

A pose bank holds `numbers` pose components at each of its knots; banks may differ in their number of knots, since the
leading components of a pose move faster than the rest. The path bank holds (x, z, heading) of the body's path. z is
ordered by stretches of time, as many as all banks can share, then bank, then knot: z.view(stretches, −1) has one row
per stretch.
"""

import math
from dataclasses import dataclass

import torch

from motionkit.core.shapes import Float, Float32, Float64, Int64, Shaped
from nerm.latents.knots import NUM_PATH_NUMBERS, KnotLayout, mix, path_speed
from nerm.settings import FieldConfig


@dataclass(frozen=True)
class Bank:
    """Knots with some numbers each."""

    knots: KnotLayout
    numbers: int


@dataclass(frozen=True, eq=False)
class LatentNumbers:
    """Describes each number of z.

    `bank` is the index of the bank (the path bank last), `knot` the index within it, `centre` that knot's t and `reach`
    its support radius in t; `component` is the pose component's rank over all pose banks, or 0, 1, 2 for the path's x,
    z and heading.
    """

    bank: Int64[torch.Tensor, "latent"]
    knot: Int64[torch.Tensor, "latent"]
    component: Int64[torch.Tensor, "latent"]
    centre: Float64[torch.Tensor, "latent"]
    reach: Float64[torch.Tensor, "latent"]


@dataclass(frozen=True, eq=False)
class KnotWeights:
    """The weights of every bank's knots at D distinct coordinates; `path` holds interpolant and slope."""

    pose: tuple[Float32[torch.Tensor, "distinct _ _"], ...]
    path: Float32[torch.Tensor, "distinct 2 _"] | None

    def first(self, coordinates: int) -> "KnotWeights":
        """The weights at the first coordinates."""
        path = None if self.path is None else self.path[:coordinates]
        return KnotWeights(tuple(each[:coordinates] for each in self.pose), path)


@dataclass(frozen=True, eq=False)
class Reading:
    """What poses read from z: the network's input, pose components first, and the body's path.

    `path` is x and z in standardised units and the heading in radians.
    """

    seen: Float32[torch.Tensor, "batch poses seen"]
    path: Float32[torch.Tensor, "batch poses 3"] | None


@dataclass(frozen=True)
class LocalLatents:
    """The banks of z; path positions are `path_unit` times their numbers, in standardised units."""

    pose: tuple[Bank, ...]
    path: Bank | None
    path_unit: float = 1.0

    @property
    def banks(self) -> tuple[Bank, ...]:
        """All banks, the path last."""
        return self.pose if self.path is None else (*self.pose, self.path)

    @property
    def num_stretches(self) -> int:
        """Number of stretches of time with whole knots of every bank."""
        return math.gcd(*(bank.knots.num_knots for bank in self.banks))

    @property
    def dimension(self) -> int:
        """d."""
        return sum(bank.knots.num_knots * bank.numbers for bank in self.banks)

    @property
    def num_components(self) -> int:
        """Pose components over all banks."""
        return sum(bank.numbers for bank in self.pose)

    @property
    def num_seen(self) -> int:
        """Size of the network's input from z at an instant."""
        of_path = 0 if self.path is None else NUM_PATH_NUMBERS
        return of_path + sum(bank.numbers * bank.knots.num_basis for bank in self.pose)

    @property
    def phase_period(self) -> float:
        """The period of the knots, in t: the spacing of the coarsest bank."""
        return 2.0 / self.num_stretches

    def split(self, latents: Float[torch.Tensor, "batch latent"]) -> list[Float[torch.Tensor, "batch _ _"]]:
        """z → [batch, knots, numbers] of each bank."""
        stretches = latents.reshape(len(latents), self.num_stretches, latents.shape[1] // self.num_stretches)
        parts = torch.split(stretches, [self._per_stretch(bank) for bank in self.banks], dim=-1)
        return [
            part.reshape(len(latents), bank.knots.num_knots, bank.numbers)
            for part, bank in zip(parts, self.banks, strict=True)
        ]

    def join(self, banks: list[Shaped[torch.Tensor, "batch _ _"]]) -> Shaped[torch.Tensor, "batch latent"]:
        """The inverse of `split`."""
        return torch.cat([knots.reshape(len(knots), self.num_stretches, -1) for knots in banks], dim=-1).flatten(1)

    def describe(self) -> LatentNumbers:
        """What each number is."""
        bank, knot, component, centre, reach = [], [], [], [], []
        first_component = 0
        for index, each in enumerate(self.banks):
            shape = (1, each.knots.num_knots, each.numbers)
            first = 0 if each is self.path else first_component
            bank.append(torch.full(shape, index))
            knot.append(torch.arange(each.knots.num_knots)[None, :, None].expand(shape))
            component.append((first + torch.arange(each.numbers)).expand(shape))
            centre.append(each.knots.centres()[None, :, None].expand(shape))
            reach.append(torch.full(shape, each.knots.reach * each.knots.spacing, dtype=torch.float64))
            first_component += each.numbers
        return LatentNumbers(*(self.join(parts)[0] for parts in (bank, knot, component, centre, reach)))

    def weights(self, coordinates: Float64[torch.Tensor, "distinct"]) -> KnotWeights:
        """Weights for reading at these coordinates."""
        path = None
        if self.path is not None:
            knots = self.path.knots
            path = torch.stack((knots.interpolant(coordinates), knots.slope(coordinates)), dim=1).float()
        return KnotWeights(tuple(bank.knots.basis(coordinates) for bank in self.pose), path)

    def read(
        self,
        latents: Float[torch.Tensor, "batch latent"],
        weights: KnotWeights,
        which: Int64[torch.Tensor, "batch poses"],
    ) -> Reading:
        """Read z at each pose of each clip, in float32 even under autocast: bfloat16 is too coarse for a path."""
        with torch.autocast(latents.device.type, enabled=False):
            banks = self.split(latents.float())
            mixed = [mix(knots, basis[which]) for knots, basis in zip(banks, weights.pose, strict=False)]
            components = [each[..., : bank.numbers] for each, bank in zip(mixed, self.pose, strict=True)]
            waves = [each[..., bank.numbers :] for each, bank in zip(mixed, self.pose, strict=True)]
            if weights.path is None:
                return Reading(torch.cat((*components, *waves), dim=-1), None)
            path, slope = mix(banks[-1], weights.path[which]).tensor_split(2, dim=-1)
            seen = torch.cat((*components, *waves, path_speed(slope, path)), dim=-1)
            return Reading(seen, path * self.path_units().to(path.device))

    def path_units(self) -> Float32[torch.Tensor, "3"]:
        """The unit of each path number: standardised units of x and of z, radians of heading."""
        return torch.tensor([self.path_unit, self.path_unit, 1.0])

    def _per_stretch(self, bank: Bank) -> int:
        return bank.knots.num_knots // self.num_stretches * bank.numbers


def local_latents(config: FieldConfig) -> LocalLatents | None:
    """The banks of a configuration; None for the paper's global latents."""
    if config.latents.layout != "local":
        return None

    def knots(count: int, modes: int) -> KnotLayout:
        return KnotLayout(count, config.latents.kernel, config.latents.radius, modes)

    pose = tuple(
        Bank(knots(count, config.latents.modes), numbers)
        for count, numbers in zip(config.latents.knots, config.latents.knot_numbers, strict=True)
    )
    path = Bank(knots(config.latents.path_knots, 0), NUM_PATH_NUMBERS) if config.latents.path_knots else None
    return LocalLatents(pose, path, config.loss.root_weight)
