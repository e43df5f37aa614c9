"""Windows in a frame of their own, and the scale of their numbers."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64

from motionkit.features import rotation_rows
from motionkit.skeleton import Skeleton

# No number counts for more than one of this share of its group's deviation: toes and collars hardly turn, and their
# noise would be learnt instead.
FLOOR_SHARE = 0.25
SMALLEST = 1e-4


@dataclass(frozen=True, eq=False)
class WindowFrames:
    """Where the frames of B windows lie in the world: yaw in radians and origin (x, z) in metres.

    Both are those of the root at the middle observed frame: a function of what is observed alone, near all of a window.
    """

    yaw: Float64[np.ndarray, "batch"]
    origin: Float64[np.ndarray, "batch 2"]

    @classmethod
    def of(cls, observed: Float32[np.ndarray, "batch frames numbers"], skeleton: Skeleton) -> "WindowFrames":
        """The frames of windows from their observed world rows."""
        middle = observed[:, (observed.shape[1] - 1) // 2]
        return cls(rotation_rows.heading(middle, skeleton), middle[:, (0, 2)].astype(np.float64))

    def enter(self, rows: Float32[np.ndarray, "batch frames numbers"]) -> Float32[np.ndarray, "batch frames numbers"]:
        """World → window."""
        return rotation_rows.turned(rows, self.yaw, self.origin)

    def leave(self, rows: Float32[np.ndarray, "batch frames numbers"]) -> Float32[np.ndarray, "batch frames numbers"]:
        """Window → world."""
        return rotation_rows.turned_back(rows, self.yaw, self.origin)


@dataclass(frozen=True, eq=False)
class Scaling:
    """(row − mean) / scale, number by number; rows in metres and columns of rotations."""

    mean: Float32[torch.Tensor, "numbers"]
    scale: Float32[torch.Tensor, "numbers"]

    def apply(self, rows: Float[torch.Tensor, "*frames numbers"]) -> Float[torch.Tensor, "*frames numbers"]:
        """Own units → standardised."""
        return (rows - self.mean) / self.scale

    def invert(self, standardised: Float[torch.Tensor, "*frames numbers"]) -> Float[torch.Tensor, "*frames numbers"]:
        """Standardised → own units."""
        return standardised * self.scale + self.mean

    def to(self, device: torch.device) -> "Scaling":
        """On another device."""
        return Scaling(self.mean.to(device), self.scale.to(device))


def measure_scaling(rows: Float32[np.ndarray, "frames numbers"]) -> Scaling:
    """Mean and scale of rows in their windows' frames.

    A number's scale is its deviation, but a quarter at least of its group's (root mean square): groups are the root's
    path (x and z, which share one scale), its height, the root's rotation and the joints' rotations.
    """
    rows = rows.astype(np.float64)
    mean, variance = rows.mean(axis=0), rows.var(axis=0)
    variance[[0, 2]] = variance[[0, 2]].mean()
    for group in (slice(0, 3, 2), slice(1, 2), slice(3, 9), slice(9, None)):
        floor = FLOOR_SHARE**2 * variance[group].mean()
        variance[group] = np.maximum(variance[group], max(floor, SMALLEST**2))
    return Scaling(torch.from_numpy(mean.astype(np.float32)), torch.from_numpy(np.sqrt(variance).astype(np.float32)))
