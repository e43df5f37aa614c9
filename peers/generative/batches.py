"""What generative peers see: batches of crops with their conditions, and how standardised rows become joints."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import torch
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor, nn

from motionkit.clips.pose_vectors.convention import PoseVectors, VectorScaling
from motionkit.core.errors import UsageError
from motionkit.features.layout import vector_layout

NO_ACTION = -1


@dataclass(frozen=True)
class ConditionSizes:
    """How many numbers a text's embedding has (0: no texts), the names of the actions, how many windows there are."""

    text_dimension: int
    actions: tuple[str, ...]
    num_windows: int = 0


@dataclass(frozen=True, eq=False)
class Conditions:
    """A batch of conditions; where none is `given`, `text` is what stands for nothing and `action` is `NO_ACTION`."""

    text: Float32[Tensor, "batch text"]
    action: Int64[Tensor, "batch"]
    given: Bool[Tensor, "batch"]

    def without(self, where: Bool[Tensor, "batch"], nothing: Float32[Tensor, "text"]) -> "Conditions":
        """The same with nothing in the rows `where`."""
        return Conditions(
            text=torch.where(where[:, None], nothing, self.text),
            action=torch.where(where, NO_ACTION, self.action),
            given=self.given & ~where,
        )

    def then(self, others: "Conditions") -> "Conditions":
        """These rows, then those of others."""
        pairs = zip(vars(self).values(), vars(others).values(), strict=True)
        return Conditions(*(torch.cat(pair) for pair in pairs))

    def repeated(self, times: int) -> "Conditions":
        """All rows so many times, one after another."""
        return Conditions(*(torch.cat((tensor,) * times) for tensor in vars(self).values()))

    def to(self, device: torch.device) -> "Conditions":
        """On a device."""
        return Conditions(*(tensor.to(device) for tensor in vars(self).values()))


@dataclass(frozen=True, eq=False)
class MotionBatch:
    """Standardised pose vectors of crops, zeros behind each one's length; `window` numbers the windows they are of.

    `frames` are the numbers that the rows have in their crops.
    """

    rows: Float32[Tensor, "batch frames numbers"]
    lengths: Int64[Tensor, "batch"]
    conditions: Conditions
    window: Int64[Tensor, "batch"]
    frames: Int64[Tensor, "batch frames"]

    @property
    def seen(self) -> Bool[Tensor, "batch frames"]:
        """Which frames there are."""
        return frames_within(self.lengths, self.rows.shape[1])

    def to(self, device: torch.device) -> "MotionBatch":
        """On a device."""
        return MotionBatch(**{name: each.to(device) for name, each in vars(self).items()})


def frames_within(lengths: Int64[Tensor, "batch"], frames: int) -> Bool[Tensor, "batch frames"]:
    """Which of so many frames lie within each length."""
    return torch.arange(frames, device=lengths.device) < lengths[:, None]


@dataclass(frozen=True, eq=False)
class Wanted:
    """Motions to make: their lengths in frames, their conditions, and what guidance holds against these.

    Row i draws from `generators[i]` alone.
    """

    lengths: Int64[Tensor, "batch"]
    conditions: Conditions
    unconditional: Conditions
    generators: Sequence[torch.Generator]
    device: torch.device

    @property
    def frames(self) -> int:
        """Of the longest."""
        return int(self.lengths.max())

    def noise(self, *shape: int) -> Float[Tensor, "batch *shape"]:
        """N(0, I) of this shape for every row, float64, on the CPU."""
        return torch.stack([torch.randn(shape, generator=each, dtype=torch.float64) for each in self.generators])

    def noise_of_frames(self, numbers: int) -> Float[Tensor, "batch frames numbers"]:
        """N(0, I) for every frame within its row's length, zeros behind: a row knows nothing of longer ones."""
        return self.noise_within(self.lengths, numbers)

    def noise_within(self, counts: Int64[Tensor, "batch"], numbers: int) -> Float[Tensor, "batch most numbers"]:
        """N(0, I) for so many places of every row, zeros behind."""
        made = torch.zeros((len(counts), int(counts.max()), numbers), dtype=torch.float64)
        for row, (count, generator) in enumerate(zip(counts.tolist(), self.generators, strict=True)):
            made[row, :count] = torch.randn((count, numbers), generator=generator, dtype=torch.float64)
        return made

    @property
    def guided(self) -> bool:
        """Whether any row has a condition."""
        return bool(self.conditions.given.any())


class PoseSpace(nn.Module):
    """The numbers that a peer learns: their scale, their framerate, and the joints that they stand for."""

    def __init__(self, vectors: PoseVectors, scaling: VectorScaling, fps: Fraction) -> None:
        super().__init__()
        self.vectors, self.fps = vectors, fps
        self.register_buffer("mean", scaling.mean, persistent=False)
        self.register_buffer("scale", scaling.scale, persistent=False)
        self.mean: Tensor
        self.scale: Tensor

    @property
    def num_numbers(self) -> int:
        """Numbers of a pose."""
        return len(self.mean)

    def joints(self, rows: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames joints 3"]:
        """Joint positions in metres of standardised `native` vectors, as `native.positions` has them.

        Raises `UsageError` for vectors of another convention.
        """
        part = vector_layout(self.vectors.skeleton.num_joints)
        if self.num_numbers != part.size:
            raise UsageError("joints are recovered of native vectors alone: motions.pose_vectors=native")
        numbers = rows * self.scale + self.mean
        angle = self.heading(numbers)
        path = self.path(numbers[..., part.root_velocity], angle)
        height = numbers[..., part.root_height]
        flat_joints = numbers[..., part.joint_positions]
        relative = flat_joints.reshape(*flat_joints.shape[:-1], -1, 3)
        flat = _turned_back(relative[..., ::2], angle[..., None, :]) + path[..., None, :]
        others = torch.stack((flat[..., 0], relative[..., 1], flat[..., 1]), dim=-1)
        root = torch.cat((path[..., :1], height, path[..., 1:]), dim=-1)
        return torch.cat((root[..., None, :], others), dim=-2)

    def heading(self, numbers: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames 1"]:
        """Radians that `native` vectors in their own units have turned by since the first frame."""
        return self._integral(numbers[..., vector_layout(self.vectors.skeleton.num_joints).root_yaw_velocity])

    def path(
        self, velocity: Float[Tensor, "batch frames 2"], angle: Float[Tensor, "batch frames 1"]
    ) -> Float[Tensor, "batch frames 2"]:
        """Metres in the first frame's x and z of velocities in the body's own."""
        return self._integral(_turned_back(velocity, angle))

    def _integral(self, rates: Tensor) -> Tensor:
        steps = (rates[:, 1:] + rates[:, :-1]) * (0.5 / float(self.fps))
        return torch.cat((torch.zeros_like(rates[:, :1]), steps.cumsum(dim=1)), dim=1)


def _turned_back(values: Tensor, angle: Tensor) -> Tensor:
    """(x, z) that stand in a frame turned to Z+ by `angle`, [..., 1], back in the first frame's."""
    cosine, sine = angle.cos()[..., 0], angle.sin()[..., 0]
    x, z = values[..., 0], values[..., 1]
    return torch.stack((cosine * x - sine * z, sine * x + cosine * z), dim=-1)


def joined_conditions(wanted: Wanted) -> Conditions:
    """Conditions and their absence, one batch behind the other."""
    return wanted.conditions.then(wanted.unconditional).to(wanted.device)
