"""Batches for the generative peers: crops with their conditions, requests to sample, and pose vectors to joints."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import torch
from torch import Tensor, nn

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float, Float32, Int64
from motionkit.features.convention import PoseVectors
from motionkit.features.layout import vector_layout
from motionkit.training.pose_vectors import VectorScaling

NO_ACTION = -1


@dataclass(frozen=True)
class ConditionSizes:
    """Dimension of a text embedding (0: no texts), names of the actions, number of training windows."""

    text_dimension: int
    actions: tuple[str, ...]
    num_windows: int = 0


@dataclass(frozen=True, eq=False)
class Conditions:
    """A batch of conditions; where none is `given`, `text` is the null embedding and `action` is `NO_ACTION`."""

    text: Float32[Tensor, "batch text"]
    action: Int64[Tensor, "batch"]
    given: Bool[Tensor, "batch"]

    def dropped(self, where: Bool[Tensor, "batch"], null: Float32[Tensor, "text"]) -> "Conditions":
        """The same, with the condition removed in the rows `where`."""
        return Conditions(
            text=torch.where(where[:, None], null, self.text),
            action=torch.where(where, NO_ACTION, self.action),
            given=self.given & ~where,
        )

    def concatenated(self, others: "Conditions") -> "Conditions":
        """Concatenate along the batch."""
        pairs = zip(vars(self).values(), vars(others).values(), strict=True)
        return Conditions(*(torch.cat(pair) for pair in pairs))

    def repeated(self, times: int) -> "Conditions":
        """Repeat the batch."""
        return Conditions(*(torch.cat((tensor,) * times) for tensor in vars(self).values()))

    def to(self, device: torch.device) -> "Conditions":
        """Move to a device."""
        return Conditions(*(tensor.to(device) for tensor in vars(self).values()))


@dataclass(frozen=True, eq=False)
class MotionBatch:
    """Standardised pose vectors of crops, zero-padded; `window` is the index of each crop's window.

    `frames` are the indices of the rows in their crops.
    """

    rows: Float32[Tensor, "batch frames numbers"]
    lengths: Int64[Tensor, "batch"]
    conditions: Conditions
    window: Int64[Tensor, "batch"]
    frames: Int64[Tensor, "batch frames"]

    @property
    def mask(self) -> Bool[Tensor, "batch frames"]:
        """True for valid frames, False for padding."""
        return frames_within(self.lengths, self.rows.shape[1])

    def to(self, device: torch.device) -> "MotionBatch":
        """Move to a device."""
        return MotionBatch(**{name: each.to(device) for name, each in vars(self).items()})


def frames_within(lengths: Int64[Tensor, "batch"], frames: int) -> Bool[Tensor, "batch frames"]:
    """A mask that is True for frames within each length."""
    return torch.arange(frames, device=lengths.device) < lengths[:, None]


@dataclass(frozen=True, eq=False)
class SampleBatch:
    """Motions to sample: lengths in frames, conditions, and the null conditions for guidance.

    Row i uses `generators[i]` alone.
    """

    lengths: Int64[Tensor, "batch"]
    conditions: Conditions
    unconditional: Conditions
    generators: Sequence[torch.Generator]
    device: torch.device

    @property
    def frames(self) -> int:
        """Frames of the longest motion."""
        return int(self.lengths.max())

    def noise(self, *shape: int) -> Float[Tensor, "batch *shape"]:
        """N(0, I) of this shape per row, float64, on the CPU."""
        return torch.stack([torch.randn(shape, generator=each, dtype=torch.float64) for each in self.generators])

    def noise_of_frames(self, numbers: int) -> Float[Tensor, "batch frames numbers"]:
        """N(0, I) for every valid frame, zero-padded: a row does not depend on longer ones in its batch."""
        return self.noise_within(self.lengths, numbers)

    def noise_within(self, counts: Int64[Tensor, "batch"], numbers: int) -> Float[Tensor, "batch most numbers"]:
        """N(0, I) for the first `counts` places of every row, zero-padded."""
        noise = torch.zeros((len(counts), int(counts.max()), numbers), dtype=torch.float64)
        for row, (count, generator) in enumerate(zip(counts.tolist(), self.generators, strict=True)):
            noise[row, :count] = torch.randn((count, numbers), generator=generator, dtype=torch.float64)
        return noise

    @property
    def guided(self) -> bool:
        """Whether any row has a condition."""
        return bool(self.conditions.given.any())


class PoseSpace(nn.Module):
    """The pose vectors that a peer learns: their scale and framerate, and how joints are recovered from them."""

    def __init__(self, vectors: PoseVectors, scaling: VectorScaling, fps: Fraction) -> None:
        super().__init__()
        self.vectors, self.fps = vectors, fps
        self.register_buffer("mean", scaling.mean, persistent=False)
        self.register_buffer("scale", scaling.scale, persistent=False)
        self.mean: Tensor
        self.scale: Tensor

    @property
    def num_features(self) -> int:
        """Size of a pose vector."""
        return len(self.mean)

    def joints(self, rows: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames joints 3"]:
        """Joint positions in metres from standardised `native` vectors, as `native.positions` does.

        Raises `UsageError` for vectors of another convention.
        """
        part = vector_layout(self.vectors.skeleton.num_joints)
        if self.num_features != part.size:
            raise UsageError("joints can only be recovered from native vectors: motions.pose_vectors=native")
        numbers = rows * self.scale + self.mean
        angle = self.heading(numbers)
        path = self.path(numbers[..., part.root_velocity], angle)
        height = numbers[..., part.root_height]
        flat_joints = numbers[..., part.joint_positions]
        relative = flat_joints.reshape(*flat_joints.shape[:-1], -1, 3)
        flat = _to_first_frame(relative[..., ::2], angle[..., None, :]) + path[..., None, :]
        others = torch.stack((flat[..., 0], relative[..., 1], flat[..., 1]), dim=-1)
        root = torch.cat((path[..., :1], height, path[..., 1:]), dim=-1)
        return torch.cat((root[..., None, :], others), dim=-2)

    def heading(self, numbers: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch frames 1"]:
        """Yaw in radians since the first frame, from unstandardised `native` vectors."""
        return self._integral(numbers[..., vector_layout(self.vectors.skeleton.num_joints).root_yaw_velocity])

    def path(
        self, velocity: Float[Tensor, "batch frames 2"], angle: Float[Tensor, "batch frames 1"]
    ) -> Float[Tensor, "batch frames 2"]:
        """The root's path in metres in the first frame's x and z, from velocities in the body's frame."""
        return self._integral(_to_first_frame(velocity, angle))

    def _integral(self, rates: Tensor) -> Tensor:
        steps = (rates[:, 1:] + rates[:, :-1]) * (0.5 / float(self.fps))
        return torch.cat((torch.zeros_like(rates[:, :1]), steps.cumsum(dim=1)), dim=1)


def _to_first_frame(values: Tensor, angle: Tensor) -> Tensor:
    """Rotate (x, z) from a body frame with yaw `angle`, [..., 1], to the first frame's."""
    cosine, sine = angle.cos()[..., 0], angle.sin()[..., 0]
    x, z = values[..., 0], values[..., 1]
    return torch.stack((cosine * x - sine * z, sine * x + cosine * z), dim=-1)


def joined_conditions(batch: SampleBatch) -> Conditions:
    """Conditions, then their null conditions, as one batch."""
    return batch.conditions.concatenated(batch.unconditional).to(batch.device)
