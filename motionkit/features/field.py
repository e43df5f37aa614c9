"""`field` pose vectors: the targets of a motion field, every number a function of time alone.

Per pose 3·J numbers: the root's x, height and z in the window's frame, then joints 1 … J − 1 relative to the root along
the same axes. A window's frame has its origin under the root at the window's first instant and faces Z+ there. No pose
needs integration, so the path cannot drift; the inverse is one addition.
"""

from dataclasses import dataclass

import numpy as np

from motionkit.core.motion import mirror_positions
from motionkit.core.shapes import Float, Float32
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.features.convention import Instants, InstantVectors, Origin, Values, Vectors, Weight, Yaw
from motionkit.features.layout import facing_direction, layout_of
from motionkit.fields.motion_field import Poses, Times

Positions = Float[np.ndarray, "windows poses joints 3"]


def heading(joint_positions: Float[np.ndarray, "*poses joints 3"]) -> Float[np.ndarray, "*poses"]:
    """Yaw in radians, in (−π, π], of the direction each body of 22 or 21 joints faces.

    0 is Z+, positive turns towards X+. Raises `UsageError` for another number of joints.
    """
    direction = facing_direction(joint_positions, layout_of(joint_positions.shape[-2]))
    return np.asarray(np.arctan2(direction[..., 0], direction[..., 1]))


def window_frame(
    first_pose: Float[np.ndarray, "windows joints 3"],
) -> tuple[Float32[np.ndarray, "windows"], Float32[np.ndarray, "windows 2"]]:
    """The frames of windows from their first poses: yaw in radians and origin (x, z) in metres."""
    yaw = heading(first_pose.astype(np.float64))
    return yaw.astype(np.float32), first_pose[:, 0, (0, 2)].astype(np.float32)


def to_window(joint_positions: Positions, yaw: Yaw, origin: Origin) -> Float32[np.ndarray, "windows poses joints 3"]:
    """World positions → positions in each window's frame, metres."""
    # Every training step calls this: `rotate_about_y`, which copies the poses first, takes twice the time. Sines of
    # float32 angles differ in their last digit between processors.
    angle, dtype = yaw.astype(np.float64)[:, None, None], joint_positions.dtype
    sine, cosine = np.sin(angle).astype(dtype), np.cos(angle).astype(dtype)
    x = joint_positions[..., 0] - origin[:, None, None, 0]
    z = joint_positions[..., 2] - origin[:, None, None, 1]
    local = np.empty(joint_positions.shape, dtype=np.float32)
    local[..., 0] = cosine * x - sine * z
    local[..., 1] = joint_positions[..., 1]
    local[..., 2] = sine * x + cosine * z
    return local


def encode(joint_positions: Positions, yaw: Yaw, origin: Origin) -> Float32[np.ndarray, "windows poses numbers"]:
    """World positions in metres → `field` vectors in the frames of `window_frame`."""
    local = to_window(joint_positions, yaw, origin)
    local[:, :, 1:] -= local[:, :, :1]
    return local.reshape(*local.shape[:2], 3 * local.shape[2])


def decode(vectors: Float[np.ndarray, "*poses numbers"]) -> Float32[np.ndarray, "*poses joints 3"]:
    """`field` vectors → positions in the window's frame, metres."""
    local = vectors.astype(np.float32).reshape(*vectors.shape[:-1], -1, 3)
    local[..., 1:, :] += local[..., :1, :]
    return local


@dataclass(frozen=True)
class FieldVectors:
    """`field` as a convention to learn (`motionkit.features.convention.PoseVectors`); values are world positions."""

    skeleton: Skeleton = SMPL22

    @property
    def num_features(self) -> int:
        """66."""
        return 3 * SMPL22.num_joints

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The root's x and z, then everything else."""
        return (0, 2), tuple(number for number in range(self.num_features) if number not in (0, 2))

    def mirror(self, values: Float32[np.ndarray, "*frames joints 3"]) -> Float32[np.ndarray, "*frames joints 3"]:
        """x negated, left and right joints exchanged."""
        return mirror_positions(values, SMPL22.left_right_pairs)

    def between(self, before: Values, after: Values, weight: Weight) -> Values:
        """On straight lines."""
        return np.asarray(before + weight[..., None, None] * (after - before))

    def encode(self, values: Values, yaw: Yaw, origin: Origin) -> Vectors:
        """Root path in the window's frame, joints relative to the root."""
        return encode(values, yaw, origin)

    def instants(self, seconds: Times) -> Times:
        """`seconds` themselves: nothing is integrated."""
        return seconds

    def decode(self, vectors: InstantVectors, instants: Instants, seconds: Times) -> Poses:
        """Adds the root to the other joints."""
        return Poses(decode(vectors))


FIELD_VECTORS = FieldVectors()
