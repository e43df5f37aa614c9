"""How the field reads a latent z.

The paper's layout, `global`, joins z to every coordinate. The layout `local` (ours) reads z as banks of knots along
time. A pose bank holds `numbers` pose components at each of its knots; banks may differ in their number of knots, since
the leading components of a pose move faster than the rest. The path bank holds (x, z, heading) of the body's path. z is
ordered by segments of time, as many as all banks can share, then bank, then knot: z.view(segments, −1) has one row per
segment.

K knots divide [−1, 1] evenly: knot k is the centre t_k = −1 + (2k + 1) / K of its interval, so that two intervals of a
bank of 32 are one of a bank of 16. With u_k = (t − t_k) / spacing, an instant reads Σ_k e_j(u_k)·z_k for every mode
j. Mode 0 is an interpolant: a Hann window, or Lanczos' windowed sinc, which passes through the knots and keeps more of
the band below their Nyquist rate; both are scaled to sum to one. The others are a Hann window times cos(πju / radius)
and sin(πju / radius). Nothing else depends on the absolute time, so the network is shift-invariant.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64, Shaped
from nerm.recipes import FieldConfig

Kernel = Literal["hann", "lanczos"]
LANCZOS_RADIUS = 3.0


@dataclass(frozen=True)
class Bank:
    """`num_knots` knots with some numbers each, and their basis functions.

    `kernel` is the interpolant, `radius` that of windows in knot spacings, `modes` the number of waves.
    """

    num_knots: int
    numbers: int
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
    def reach(self) -> float:
        """Support radius of a knot's basis functions, in knot spacings."""
        of_kernel = LANCZOS_RADIUS if self.kernel == "lanczos" else self.radius
        return max(of_kernel, self.radius) if self.modes else of_kernel

    def centres(self) -> Float64[Tensor, "knots"]:
        """Positions of the knots in [−1, 1]."""
        return -1.0 + (torch.arange(self.num_knots, dtype=torch.float64) + 0.5) * self.spacing

    def interpolant(self, coordinates: Float64[Tensor, "times"]) -> Float64[Tensor, "times knots"]:
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

    def slope(self, coordinates: Float64[Tensor, "times"]) -> Float64[Tensor, "times knots"]:
        """The interpolant's derivative, per knot spacing (by central differences)."""
        step = 1e-4 * self.spacing
        return (self.interpolant(coordinates + step) - self.interpolant(coordinates - step)) / 2e-4

    def basis(self, coordinates: Float64[Tensor, "times"]) -> Float32[Tensor, "times basis knots"]:
        """Weights of all knots at some coordinates, for each mode; zero outside a knot's reach."""
        offset = self._offset(coordinates)
        bump = _hann(offset, self.radius)
        angles = [math.pi * mode * offset / self.radius for mode in range(1, self.modes + 1)]
        waves = [bump * wave(angle) for angle in angles for wave in (torch.cos, torch.sin)]
        return torch.stack([self.interpolant(coordinates), *waves], dim=1).float()

    def _offset(self, coordinates: Float64[Tensor, "times"], outside: int = 0) -> Float64[Tensor, "times offsets"]:
        """Distances in knot spacings from all knots, and from as many beyond either end."""
        knots = torch.arange(-outside, self.num_knots + outside, dtype=torch.float64, device=coordinates.device)
        return (coordinates[:, None] + 1.0) / self.spacing - (knots + 0.5)


def _hann(offset: Float64[Tensor, "times offsets"], radius: float) -> Float64[Tensor, "times offsets"]:
    """A Hann window of unit area."""
    return 0.5 * (1.0 + torch.cos(math.pi * offset / radius)) * (offset.abs() < radius) / radius


def mix(
    knots: Float[Tensor, "batch knots width"], basis: Float[Tensor, "batch poses basis knots"]
) -> Float[Tensor, "batch poses mixed"]:
    """Apply each pose's basis weights to its clip's knots: [batch, poses, basis · width]."""
    batch, poses, functions, num_knots = basis.shape
    mixed = torch.bmm(basis.reshape(batch, poses * functions, num_knots), knots)
    return mixed.reshape(batch, poses, functions * knots.shape[-1])


NUM_PATH_NUMBERS = 3


def turned(vectors: Float[Tensor, "*poses numbers"], yaw: Float[Tensor, "*poses"]) -> Float[Tensor, "*poses numbers"]:
    """Rotate `field` vectors about the vertical by radians (positive from Z+ towards X+), root position included."""
    cosine, sine = torch.cos(yaw)[..., None], torch.sin(yaw)[..., None]
    x, y, z = vectors.reshape(*vectors.shape[:-1], vectors.shape[-1] // 3, 3).unbind(-1)
    return torch.stack((cosine * x + sine * z, y, cosine * z - sine * x), dim=-1).flatten(-2)


def placed(
    relative: Float[Tensor, "*poses numbers"], path: Float[Tensor, "*poses 3"]
) -> Float[Tensor, "*poses numbers"]:
    """Poses relative to a path → `field` vectors in the window's frame."""
    return _moved(turned(relative, path[..., 2]), path, 1.0)


def relative_to(
    vectors: Float[Tensor, "*poses numbers"], path: Float[Tensor, "*poses 3"]
) -> Float[Tensor, "*poses numbers"]:
    """`field` vectors in the window's frame → poses relative to a path; the inverse of `placed`."""
    return turned(_moved(vectors, path, -1.0), -path[..., 2])


def path_speed(slope: Float[Tensor, "*poses 3"], path: Float[Tensor, "*poses 3"]) -> Float[Tensor, "*poses 3"]:
    """The path's velocity in the body's frame: sideways, forward, turning."""
    cosine, sine = torch.cos(path[..., 2]), torch.sin(path[..., 2])
    x, z, turning = slope.unbind(-1)
    return torch.stack((cosine * x - sine * z, sine * x + cosine * z, turning), dim=-1)


def _moved(
    vectors: Float[Tensor, "*poses numbers"], path: Float[Tensor, "*poses 3"], sign: float
) -> Float[Tensor, "*poses numbers"]:
    x, height, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    root = torch.stack((x + sign * path[..., 0], height, z + sign * path[..., 1]), dim=-1)
    return torch.cat((root, vectors[..., 3:]), dim=-1)


@dataclass(frozen=True, eq=False)
class LatentNumbers:
    """Describes each number of z.

    `bank` is the index of the bank (the path bank last), `knot` the index within it, `centre` that knot's t and `reach`
    its support radius in t; `component` is the pose component's rank over all pose banks, or 0, 1, 2 for the path's x,
    z and heading.
    """

    bank: Int64[Tensor, "latent"]
    knot: Int64[Tensor, "latent"]
    component: Int64[Tensor, "latent"]
    centre: Float64[Tensor, "latent"]
    reach: Float64[Tensor, "latent"]


@dataclass(frozen=True, eq=False)
class KnotWeights:
    """The weights of every bank's knots at D distinct coordinates; `path` holds interpolant and slope."""

    pose: tuple[Float32[Tensor, "distinct _ _"], ...]
    path: Float32[Tensor, "distinct 2 _"] | None

    def first(self, coordinates: int) -> "KnotWeights":
        """The weights at the first coordinates."""
        path = None if self.path is None else self.path[:coordinates]
        return KnotWeights(tuple(each[:coordinates] for each in self.pose), path)


@dataclass(frozen=True, eq=False)
class Reading:
    """What poses read from z: the network's input, pose components first, and the body's path.

    `path` is x and z in standardised units and the heading in radians.
    """

    inputs: Float32[Tensor, "batch poses inputs"]
    path: Float32[Tensor, "batch poses 3"] | None


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
    def num_segments(self) -> int:
        """Number of segments of time with whole knots of every bank."""
        return math.gcd(*(bank.num_knots for bank in self.banks))

    @property
    def dimension(self) -> int:
        """d."""
        return sum(bank.num_knots * bank.numbers for bank in self.banks)

    @property
    def num_components(self) -> int:
        """Pose components over all banks."""
        return sum(bank.numbers for bank in self.pose)

    @property
    def num_inputs(self) -> int:
        """Size of the network's input from z at an instant."""
        of_path = 0 if self.path is None else NUM_PATH_NUMBERS
        return of_path + sum(bank.numbers * (1 + 2 * bank.modes) for bank in self.pose)

    @property
    def phase_period(self) -> float:
        """The period of the knots, in t: the spacing of the coarsest bank."""
        return 2.0 / self.num_segments

    def split(self, latents: Float[Tensor, "batch latent"]) -> list[Float[Tensor, "batch _ _"]]:
        """z → [batch, knots, numbers] of each bank."""
        segments = latents.reshape(len(latents), self.num_segments, latents.shape[1] // self.num_segments)
        sizes = [bank.num_knots // self.num_segments * bank.numbers for bank in self.banks]
        of_bank = torch.split(segments, sizes, dim=-1)
        return [
            knots.reshape(len(latents), bank.num_knots, bank.numbers)
            for knots, bank in zip(of_bank, self.banks, strict=True)
        ]

    def join(self, banks: list[Shaped[Tensor, "batch _ _"]]) -> Shaped[Tensor, "batch latent"]:
        """The inverse of `split`."""
        return torch.cat([knots.reshape(len(knots), self.num_segments, -1) for knots in banks], dim=-1).flatten(1)

    def describe(self) -> LatentNumbers:
        """What each number is."""
        bank, knot, component, centre, reach = [], [], [], [], []
        first_component = 0
        for index, each in enumerate(self.banks):
            shape = (1, each.num_knots, each.numbers)
            first = 0 if each is self.path else first_component
            bank.append(torch.full(shape, index))
            knot.append(torch.arange(each.num_knots)[None, :, None].expand(shape))
            component.append((first + torch.arange(each.numbers)).expand(shape))
            centre.append(each.centres()[None, :, None].expand(shape))
            reach.append(torch.full(shape, each.reach * each.spacing, dtype=torch.float64))
            first_component += each.numbers
        return LatentNumbers(*(self.join(values)[0] for values in (bank, knot, component, centre, reach)))

    def weights(self, coordinates: Float64[Tensor, "distinct"]) -> KnotWeights:
        """Weights for reading at these coordinates."""
        path = None
        if self.path is not None:
            path = torch.stack((self.path.interpolant(coordinates), self.path.slope(coordinates)), dim=1).float()
        return KnotWeights(tuple(bank.basis(coordinates) for bank in self.pose), path)

    def read(
        self,
        latents: Float[Tensor, "batch latent"],
        weights: KnotWeights,
        which: Int64[Tensor, "batch poses"],
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
            inputs = torch.cat((*components, *waves, path_speed(slope, path)), dim=-1)
            return Reading(inputs, path * self.path_units().to(path.device))

    def path_units(self) -> Float32[Tensor, "3"]:
        """The unit of each path number: standardised units of x and of z, radians of heading."""
        return torch.tensor([self.path_unit, self.path_unit, 1.0])


def local_latents(config: FieldConfig) -> LocalLatents | None:
    """The banks of a configuration; None for the paper's global latents."""
    if config.latents.layout != "local":
        return None

    latents = config.latents
    shape = latents.kernel, latents.radius
    banks = zip(latents.knots, latents.knot_numbers, strict=True)
    pose = tuple(Bank(count, numbers, *shape, latents.modes) for count, numbers in banks)
    path = Bank(latents.path_knots, NUM_PATH_NUMBERS, *shape, 0) if latents.path_knots else None
    return LocalLatents(pose, path, config.loss.root_weight)


ALWAYS = -1.0


def first_read(dimension: int, banks: LocalLatents | None) -> Float32[Tensor, "latent"]:
    """The earliest instant, in units of l_max, at which the field reads each number of z; `ALWAYS` without knots."""
    if banks is None:
        return torch.full((dimension,), ALWAYS)
    numbers = banks.describe()
    return (0.5 * (1.0 + numbers.centre - numbers.reach)).to(torch.float32)


def in_use(first_read: Float32[Tensor, "latent"], duration: Float32[Tensor, "batch"]) -> Bool[Tensor, "batch latent"]:
    """Mask of the numbers that motions of these durations (in units of l_max) use."""
    return first_read < duration[:, None]
