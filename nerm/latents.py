"""The latent z: how the field reads it, what it begins as, and the numbers that the diffusion sees.

The paper's layout, `global`, joins z to every coordinate. The layout `local` (ours) reads z as banks of knots along
time. A pose bank holds `numbers` pose components at each of its knots; banks may differ in their number of knots, since
the leading components of a pose move faster than the rest. The path bank holds (x, z, heading) of the body's path. z is
ordered by segments of time, as many as all banks can share, then bank, then knot: z.view(segments, −1) has one row per
segment.

K knots divide [−1, 1] evenly: knot k is the centre t_k = −1 + (2k + 1) / K of its interval, so that two intervals of a
bank of 32 are one of a bank of 16. With u_k = (t − t_k) / spacing, an instant reads Σ_k e_j(u_k)·z_k for every mode
j. Mode 0 is an interpolant: Lanczos' windowed sinc, scaled to sum to one, which passes through the knots. The others
are a Hann window times cos(πju / 3) and sin(πju / 3). Nothing else depends on the absolute time, so the network is
shift-invariant.

Local latents start from a linear model of the poses, fitted to a window by ridge regression: the path bank is fitted to
the root's path and heading, then the pose banks to the principal components of the poses relative to the fitted path.
The network starts as the same linear model.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64, Shaped
from motionkit.features import field
from motionkit.training.networks import VectorScaling
from nerm.recipes import FieldConfig

# Of all basis functions, in knot spacings; waves beside the interpolant.
RADIUS, NUM_WAVES = 3, 3
NUM_PATH_NUMBERS = 3
RIDGE, HELD_TIMES = 0.02, 128
SMALLEST_DEVIATION = 1e-6
ALWAYS = -1.0


@dataclass(frozen=True)
class Bank:
    """`num_knots` knots of some numbers each, and their basis functions."""

    num_knots: int
    numbers: int

    def __post_init__(self) -> None:
        if self.num_knots < 2:
            raise ValueError("a local latent needs at least two knots")

    @property
    def spacing(self) -> float:
        """Distance between knots in units of t."""
        return 2.0 / self.num_knots

    def interpolant(self, coordinates: Float64[Tensor, "times"]) -> Float64[Tensor, "times knots"]:
        """Weights of mode 0, which sum to one at each time.

        In the half spacing before the first knot and after the last, knots are extrapolated linearly.
        """
        near, offset = self._near(coordinates)
        weights = torch.sinc(offset) * torch.sinc(offset / RADIUS) * (offset.abs() < RADIUS)
        weights = self._spread(weights / weights.sum(dim=1, keepdim=True), near)
        before, own, after = weights.tensor_split((RADIUS, RADIUS + self.num_knots), dim=1)
        distance = torch.arange(1, RADIUS + 1, dtype=torch.float64, device=weights.device)
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
        """Weights of all knots at some coordinates, for each mode; zero outside a knot's radius."""
        near, offset = self._near(coordinates)
        bump = 0.5 * (1.0 + torch.cos(math.pi * offset / RADIUS)) * (offset.abs() < RADIUS) / RADIUS
        angles = [math.pi * mode * offset / RADIUS for mode in range(1, NUM_WAVES + 1)]
        waves = [self._spread(bump * wave(angle), near) for angle in angles for wave in (torch.cos, torch.sin)]
        within = [wave[:, RADIUS:-RADIUS] for wave in waves]
        return torch.stack([self.interpolant(coordinates), *within], dim=1).float()

    def _near(
        self, coordinates: Float64[Tensor, "times"]
    ) -> tuple[Int64[Tensor, "times near"], Float64[Tensor, "times near"]]:
        """The knots within the radius, counted from `RADIUS` before the first, and the distances in knot spacings."""
        position = (coordinates[:, None] + 1.0) / self.spacing
        near = torch.floor(position - 0.5) + torch.arange(1 - RADIUS, 1 + RADIUS, device=position.device)
        return near.long() + RADIUS, position - (near + 0.5)

    def _spread(
        self, weights: Float64[Tensor, "times near"], near: Int64[Tensor, "times near"]
    ) -> Float64[Tensor, "times offsets"]:
        """Weights of near knots → of all knots, and of `RADIUS` more beyond either end."""
        return weights.new_zeros(len(near), self.num_knots + 2 * RADIUS).scatter(1, near, weights)


def mix(
    knots: Float[Tensor, "batch knots width"], basis: Float[Tensor, "batch poses basis knots"]
) -> Float[Tensor, "batch poses mixed"]:
    """Apply each pose's basis weights to its clip's knots: [batch, poses, basis · width]."""
    batch, poses, functions, num_knots = basis.shape
    mixed = torch.bmm(basis.reshape(batch, poses * functions, num_knots), knots)
    return mixed.reshape(batch, poses, functions * knots.shape[-1])


@dataclass(frozen=True)
class LocalLatents:
    """The banks of z; path positions are `path_unit` times their numbers, in standardised units."""

    pose: tuple[Bank, ...]
    path: Bank
    path_unit: float = 1.0

    @property
    def banks(self) -> tuple[Bank, ...]:
        """All banks, the path last."""
        return (*self.pose, self.path)

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
        return NUM_PATH_NUMBERS + self.num_components * (1 + 2 * NUM_WAVES)

    @property
    def phase_period(self) -> float:
        """The period of the knots, in t: the spacing of the coarsest bank."""
        return 2.0 / self.num_segments

    @property
    def path_units(self) -> Float32[Tensor, "3"]:
        """The unit of each path number: standardised units of x and of z, radians of heading."""
        return torch.tensor([self.path_unit, self.path_unit, 1.0])

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

    def weights(self, coordinates: Float64[Tensor, "distinct"]) -> tuple[Float32[Tensor, "distinct _ _"], ...]:
        """Each bank's weights at these coordinates: all modes of a pose bank, interpolant and slope of the path."""
        path = torch.stack((self.path.interpolant(coordinates), self.path.slope(coordinates)), dim=1).float()
        return (*(bank.basis(coordinates) for bank in self.pose), path)

    def read(
        self,
        latents: Float[Tensor, "batch latent"],
        weights: tuple[Float32[Tensor, "distinct _ _"], ...],
        which: Int64[Tensor, "batch poses"],
    ) -> tuple[Float32[Tensor, "batch poses inputs"], Float32[Tensor, "batch poses 3"]]:
        """Read z at each pose of each clip: the network's input, pose components first, and the body's path.

        The path is x and z in standardised units and the heading in radians; the input has its velocity in the body's
        frame (sideways, forward, turning). In float32 even under autocast: bfloat16 is too coarse for a path.
        """
        with torch.autocast(latents.device.type, enabled=False):
            banks = self.split(latents.float())
            *mixed, of_path = (mix(knots, basis[which]) for knots, basis in zip(banks, weights, strict=True))
            components = [each[..., : bank.numbers] for each, bank in zip(mixed, self.pose, strict=True)]
            waves = [each[..., bank.numbers :] for each, bank in zip(mixed, self.pose, strict=True)]
            path, slope = of_path.tensor_split(2, dim=-1)
            cosine, sine = torch.cos(path[..., 2]), torch.sin(path[..., 2])
            x, z, turning = slope.unbind(-1)
            speed = torch.stack((cosine * x - sine * z, sine * x + cosine * z, turning), dim=-1)
            return torch.cat((*components, *waves, speed), dim=-1), path * self.path_units.to(path.device)


def local_latents(config: FieldConfig) -> LocalLatents | None:
    """The banks of a configuration; None for the paper's global latents."""
    latents = config.latents
    if latents.layout == "global":
        return None
    banks = zip(latents.knots, latents.knot_numbers, strict=True)
    path = Bank(latents.path_knots, NUM_PATH_NUMBERS)
    return LocalLatents(tuple(Bank(count, numbers) for count, numbers in banks), path, config.loss.root_weight)


def first_read(dimension: int, banks: LocalLatents | None) -> Float32[Tensor, "latent"]:
    """The earliest instant, in units of l_max, at which the field reads each number of z; `ALWAYS` without knots."""
    if banks is None:
        return torch.full((dimension,), ALWAYS)
    earliest = []
    for bank in banks.banks:
        centres = -1.0 + (torch.arange(bank.num_knots, dtype=torch.float64) + 0.5) * bank.spacing
        instants = 0.5 * (1.0 + centres - RADIUS * bank.spacing)
        earliest.append(instants[None, :, None].expand(1, -1, bank.numbers))
    return banks.join(earliest)[0].to(torch.float32)


def in_use(first_read: Float32[Tensor, "latent"], duration: Float32[Tensor, "batch"]) -> Bool[Tensor, "batch latent"]:
    """Mask of the numbers that motions of these durations (in units of l_max) use."""
    return first_read < duration[:, None]


def placed(
    relative: Float[Tensor, "*poses numbers"], path: Float[Tensor, "*poses 3"]
) -> Float[Tensor, "*poses numbers"]:
    """Poses relative to a path → `field` vectors in the window's frame."""
    return _moved(_turned(relative, path[..., 2]), path, 1.0)


def relative_to(
    vectors: Float[Tensor, "*poses numbers"], path: Float[Tensor, "*poses 3"]
) -> Float[Tensor, "*poses numbers"]:
    """`field` vectors in the window's frame → poses relative to a path; the inverse of `placed`."""
    return _turned(_moved(vectors, path, -1.0), -path[..., 2])


def _turned(vectors: Float[Tensor, "*poses numbers"], yaw: Float[Tensor, "*poses"]) -> Float[Tensor, "*poses numbers"]:
    """Rotate `field` vectors about the vertical by radians (positive from Z+ towards X+), root position included."""
    cosine, sine = torch.cos(yaw)[..., None], torch.sin(yaw)[..., None]
    x, y, z = vectors.reshape(*vectors.shape[:-1], vectors.shape[-1] // 3, 3).unbind(-1)
    return torch.stack((cosine * x + sine * z, y, cosine * z - sine * x), dim=-1).flatten(-2)


def _moved(
    vectors: Float[Tensor, "*poses numbers"], path: Float[Tensor, "*poses 3"], sign: float
) -> Float[Tensor, "*poses numbers"]:
    x, height, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    root = torch.stack((x + sign * path[..., 0], height, z + sign * path[..., 1]), dim=-1)
    return torch.cat((root, vectors[..., 3:]), dim=-1)


def ridge_knots(
    targets: Float[Tensor, "windows times width"],
    coordinates: Float64[Tensor, "windows times"],
    counts: Float[Tensor, "windows times"],
    bank: Bank,
    ridge: float = RIDGE,
) -> Float32[Tensor, "windows knots width"]:
    """Fit knots to targets at given coordinates by ridge regression.

    `counts` weights the instants; the ridge is in units of one instant.
    """
    weights = bank.interpolant(coordinates.reshape(-1)).reshape(*coordinates.shape, bank.num_knots)
    counted = (weights * counts[..., None]).transpose(1, 2)
    gram = counted @ weights + ridge * torch.eye(bank.num_knots, dtype=torch.float64)
    knots: Tensor = torch.linalg.solve(gram, counted @ targets.double())
    return knots.float()


@dataclass(frozen=True, eq=False)
class LinearModel:
    """The linear model of local latents, on the CPU.

    `directions` map standardised poses relative to the path, minus `mean`, to principal components of unit variance.
    """

    banks: LocalLatents
    scaling: VectorScaling
    mean: Float32[Tensor, "numbers"]
    directions: Float32[Tensor, "numbers components"]

    def fit(
        self, coordinates: Float64[Tensor, "batch poses"], vectors: Float32[Tensor, "batch poses numbers"]
    ) -> Float32[Tensor, "batch latent"]:
        """Latents of windows from `field` vectors at coordinates in order of time.

        The last pose is held from a window's end to t = 1, so that knots beyond the end describe a body that stands
        still instead of being undetermined.
        """
        grid = torch.linspace(-1.0, 1.0, HELD_TIMES, dtype=torch.float64).expand(len(vectors), -1)
        counts = torch.cat((torch.ones_like(coordinates), (grid > coordinates[:, -1:]).double()), dim=1)
        vectors = torch.cat((vectors, vectors[:, -1:].expand(-1, HELD_TIMES, -1)), dim=1)
        coordinates = torch.cat((coordinates, grid), dim=1)
        path_knots, relative = without_path(coordinates, vectors, counts, self.banks, self.scaling)
        components = torch.split(
            (relative - self.mean) @ self.directions, [bank.numbers for bank in self.banks.pose], dim=-1
        )
        pose_knots = [
            ridge_knots(targets, coordinates, counts, bank)
            for targets, bank in zip(components, self.banks.pose, strict=True)
        ]
        return self.banks.join([*pose_knots, path_knots])

    def inverse(self) -> Float32[Tensor, "components numbers"]:
        """Maps components back to centred vectors (a pseudo-inverse)."""
        matrix: Tensor = torch.linalg.pinv(self.directions)
        return matrix


def linear_model(
    windows: Iterable[tuple[Float64[Tensor, "some times"], Float32[Tensor, "some times numbers"]]],
    scaling: VectorScaling,
    banks: LocalLatents,
) -> LinearModel:
    """The linear model of windows, given as coordinates and `field` vectors of some at a time; one pass."""
    size = len(scaling.mean)
    count, total, outer = 0, torch.zeros(size).double(), torch.zeros(size, size).double()
    for coordinates, vectors in windows:
        relative = without_path(coordinates, vectors, torch.ones_like(coordinates), banks, scaling)[1]
        relative = relative.double().flatten(0, 1)
        count += len(relative)
        total, outer = total + relative.sum(0), outer + relative.T @ relative
    mean = total / count
    values, axes = torch.linalg.eigh(outer / count - torch.outer(mean, mean))
    largest = torch.argsort(values, descending=True)[: banks.num_components]
    directions = axes[:, largest] / values[largest].clamp(min=1e-12).sqrt()
    return LinearModel(banks, scaling, mean.float(), directions.float())


def without_path(
    coordinates: Float64[Tensor, "batch times"],
    vectors: Float32[Tensor, "batch times numbers"],
    counts: Float64[Tensor, "batch times"],
    banks: LocalLatents,
    scaling: VectorScaling,
) -> tuple[Float32[Tensor, "batch knots 3"], Float32[Tensor, "batch times numbers"]]:
    """The path bank's knots, fitted to root and heading, and standardised poses relative to that path."""
    standardised = scaling.apply(vectors)
    x, z = standardised[..., 0].double(), standardised[..., 2].double()
    heading = field.heading(field.decode(vectors.numpy())).astype(np.float64)
    measured = torch.stack((x, z, torch.from_numpy(np.unwrap(heading, axis=1))), dim=-1)
    units = banks.path_units.double()
    knots = ridge_knots(measured / units, coordinates, counts, banks.path)
    weights = banks.path.interpolant(coordinates.reshape(-1)).reshape(*coordinates.shape, -1)
    path = (weights @ knots.double()) * units
    return knots, relative_to(standardised, path.float())


@dataclass(frozen=True, eq=False)
class LatentSpace:
    """The map between latents of the field and standardised numbers of the same size.

    `banks` is the layout of z (None: global); `mean` and `deviation` are those of latents with their path as steps.
    """

    banks: LocalLatents | None
    mean: Float32[Tensor, "latent"]
    deviation: Float32[Tensor, "latent"]

    def standardise(self, latents: Float32[Tensor, "batch latent"]) -> Float32[Tensor, "batch latent"]:
        """Latents of the field → numbers of the diffusion."""
        return (with_steps(latents, self.banks) - self.mean) / self.deviation

    def restore(self, numbers: Float32[Tensor, "batch latent"]) -> Float32[Tensor, "batch latent"]:
        """The inverse of `standardise`."""
        latents = numbers * self.deviation + self.mean
        if self.banks is None:
            return latents
        *poses, steps = self.banks.split(latents)
        return self.banks.join([*poses, places_of(steps)])


def with_steps(latents: Float32[Tensor, "batch latent"], banks: LocalLatents | None) -> Float32[Tensor, "batch latent"]:
    """Latents with their path, if any, as steps between knots.

    As positions, a path spreads over metres while its steps are centimetres, so the denoiser's residual noise would be
    metres per second of sliding. As steps in the body's frame, a path is as stationary as the poses.
    """
    if banks is None:
        return latents
    *poses, places = banks.split(latents)
    return banks.join([*poses, steps_of(places)])


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


def kinds_of_numbers(dimension: int, banks: LocalLatents | None) -> Int64[Tensor, "latent"]:
    """Groups of numbers of z that share a mean and a deviation, as an index per number.

    A group is one component of a bank at all its knots, except the first position of a path, which is no step. Without
    banks each number is its own group.
    """
    if banks is None:
        return torch.arange(dimension)
    kinds, first = [], 0
    for bank in banks.banks:
        kinds.append((first + torch.arange(bank.numbers)).repeat(1, bank.num_knots, 1))
        first += bank.numbers
    kinds[-1][:, 0] += NUM_PATH_NUMBERS
    return banks.join(kinds)[0]


def measured_space(
    latents: Float32[Tensor, "draws latent"], used: Bool[Tensor, "draws latent"], banks: LocalLatents | None
) -> LatentSpace:
    """The space in which samples of latents have mean 0 and deviation 1, over the motions that use each number.

    A number that no motion uses gets mean 0 and deviation 1.
    """
    numbers, share = with_steps(latents, banks).to(torch.float64), used.to(torch.float64)
    kinds = kinds_of_numbers(latents.shape[1], banks)

    def over_kinds(sums: Float64[Tensor, "latent"]) -> Float64[Tensor, "latent"]:
        return torch.zeros(int(kinds.max()) + 1, dtype=torch.float64).index_add(0, kinds, sums)[kinds]

    counts = over_kinds(share.sum(dim=0))
    mean = over_kinds((numbers * share).sum(dim=0)) / counts.clamp(min=1)
    variance = over_kinds(((numbers - mean).square() * share).sum(dim=0)) / counts.clamp(min=1)
    deviation = torch.where(counts > 0, variance.sqrt().clamp(min=SMALLEST_DEVIATION), torch.ones_like(variance))
    return LatentSpace(banks, mean.to(torch.float32), deviation.to(torch.float32))
