"""Joint layouts of the pose-vector conventions: facing joints, chains, slices of the vector, rotations of bones."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import UsageError
from motionkit.core.shapes import Bool, Float, Float32, Float64
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton

if TYPE_CHECKING:
    from motionkit.io.humanml3d import VectorLayout


@dataclass(frozen=True, eq=False)
class PoseLayout:
    """A joint layout for which pose vectors are defined.

    `lateral_joints` are the right and left hip, and the right and left shoulder, whose lateral axes give the facing
    direction; `chains` are the kinematic chains of the published inverse kinematics, each starting at a joint of an
    earlier one or at the root; `bone_directions` [J, 3] are the rest directions of the bones that end in each joint;
    `leg_joints` are the two bones of one leg whose lengths give the body's scale; `contact_threshold` is the squared
    displacement per frame, in the published files' unit, below which a foot is in contact.
    """

    skeleton: Skeleton
    lateral_joints: tuple[tuple[int, int], tuple[int, int]]
    chains: tuple[tuple[int, ...], ...]
    bone_directions: tuple[tuple[int, int, int], ...]
    leg_joints: tuple[int, int]
    contact_threshold: float

    @cached_property
    def vector(self) -> "VectorLayout":
        """Slices of its pose vectors."""
        from motionkit.io.humanml3d import vector_layout  # deferred: `field` vectors need no slices

        return vector_layout(self.num_joints)

    @property
    def name(self) -> str:
        """The layout's name, that of its skeleton."""
        return self.skeleton.name

    @property
    def num_joints(self) -> int:
        """Number of joints J."""
        return self.skeleton.num_joints

    @property
    def contact_joints(self) -> tuple[int, int, int, int]:
        """Left ankle, left toe, right ankle, right toe."""
        feet = self.skeleton.feet
        assert feet is not None
        return feet.left_ankle, feet.left_toe, feet.right_ankle, feet.right_toe

    @cached_property
    def previous_bones(self) -> list[int]:
        """The bone before each bone 1 … J − 1 in its chain; 0, the root, for the first of any chain, also an arm's."""
        previous = {bone: before for chain in self.chains for before, bone in pairwise((0, *chain[1:]))}
        return [previous[bone] for bone in range(1, self.num_joints)]


_X, _Y, _Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
_MX, _MY, _NONE = (-1, 0, 0), (0, -1, 0), (0, 0, 0)

# Chains, directions, facing joints and thresholds: HumanML3D, paramUtil.py and motion_representation.ipynb.
SMPL22_LAYOUT = PoseLayout(
    skeleton=SMPL22,
    lateral_joints=((2, 1), (17, 16)),
    chains=((0, 2, 5, 8, 11), (0, 1, 4, 7, 10), (0, 3, 6, 9, 12, 15), (9, 14, 17, 19, 21), (9, 13, 16, 18, 20)),
    bone_directions=(_NONE, _X, _MX, _Y, _MY, _MY, _Y, _MY, _MY, _Y, _Z, _Z, _Y, _X, _MX, _Z, *(_MY,) * 6),
    leg_joints=(5, 8),
    contact_threshold=0.002,
)

KIT21_LAYOUT = PoseLayout(
    skeleton=KIT21,
    lateral_joints=((11, 16), (5, 8)),
    chains=((0, 11, 12, 13, 14, 15), (0, 16, 17, 18, 19, 20), (0, 1, 2, 3, 4), (3, 5, 6, 7), (3, 8, 9, 10)),
    bone_directions=(
        *(_NONE, _Y, _Y, _Y, _Y, _X, _MY, _MY, _MX, _MY, _MY),
        *(_X, _MY, _MY, _Z, _Z, _MX, _MY, _MY, _Z, _Z),
    ),
    leg_joints=(17, 18),
    contact_threshold=0.05,
)

LAYOUTS = {"smpl22": SMPL22_LAYOUT, "kit21": KIT21_LAYOUT}


def pose_layout(name: str) -> PoseLayout:
    """The layout `smpl22` or `kit21`, by name; raises `UsageError` for others."""
    if name not in LAYOUTS:
        raise UsageError(f"pose vectors are defined for the layouts {', '.join(LAYOUTS)}, not for {name!r}")
    return LAYOUTS[name]


def layout_of_poses(joint_positions: Float[np.ndarray, "frames joints 3"], name: str) -> PoseLayout:
    """The layout of this name; raises `ValueError` for another number of joints or fewer than two poses."""
    body, (num_frames, num_joints, _) = pose_layout(name), joint_positions.shape
    if num_joints != body.num_joints or num_frames < 2:
        message = f"{name} vectors need at least 2 poses of {body.num_joints} joints"
        raise ValueError(f"{message}, not {num_frames} of {num_joints}")
    return body


def layout_of(num_joints: int) -> PoseLayout:
    """The layout with this many joints (22 or 21); raises `UsageError` for other counts."""
    for layout in LAYOUTS.values():
        if layout.num_joints == num_joints:
            return layout
    known = ", ".join(f"{layout.name} ({layout.num_joints} joints)" for layout in LAYOUTS.values())
    raise UsageError(f"no joint layout has {num_joints} joints; map the motion to one of {known} first")


def across(
    joint_positions: Float[np.ndarray, "*poses joints 3"], body: PoseLayout
) -> list[Float[np.ndarray, "*poses 3"]]:
    """The vectors from the left to the right hip, and from the left to the right shoulder."""
    return [joint_positions[..., right, :] - joint_positions[..., left, :] for right, left in body.lateral_joints]


def facing_direction(
    joint_positions: Float[np.ndarray, "*poses joints 3"], body: PoseLayout
) -> Float[np.ndarray, "*poses 2"]:
    """Horizontal facing direction (x, z) of each pose, not normalised: Y × ((R − L hip) + (R − L shoulder))."""
    hips, shoulders = across(joint_positions, body)
    return np.stack(((hips + shoulders)[..., 2], -(hips + shoulders)[..., 0]), axis=-1)


def half_angles_to_z(sideways: Float[np.ndarray, "frames 3"], sigma_frames: float) -> Float64[np.ndarray, "frames"]:
    """Half the angle about Y, in (−π/2, π/2], from each smoothed facing, Y × `sideways`, to Z+.

    A body lying on its side has a short horizontal lateral axis, and so little weight in the smoothed facing.
    """
    length = np.linalg.norm(sideways, axis=-1, keepdims=True)
    unit = sideways / np.where(length > 0, length, 1.0)
    forward = smooth(np.stack((unit[:, 2], -unit[:, 0]), axis=-1), sigma_frames)
    return np.asarray(0.5 * np.arctan2(-forward[:, 0], forward[:, 1]))


def smooth(values: Float[np.ndarray, "frames columns"], sigma_frames: float) -> Float64[np.ndarray, "frames columns"]:
    """Gaussian smoothing along time, with the end values repeated beyond both ends.

    The kernel is sampled at whole frames and truncated at 4σ, as in `scipy.ndimage.gaussian_filter1d(mode="nearest")`,
    which takes ten times as long at 120 fps.
    """
    reach = int(4.0 * sigma_frames + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_frames) ** 2)
    padded = np.pad(values.astype(np.float64), ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, kernel / kernel.sum(), mode="valid") for column in padded.T], axis=-1)


def relative_to_root(
    joint_positions: Float[np.ndarray, "frames joints 3"], angle: Float[np.ndarray, "frames"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Positions with the root above the origin, rotated about Y by each frame's angle; heights are kept."""
    below = joint_positions[:, :1] * np.array([1, 0, 1], joint_positions.dtype)
    return kinematics.rotate_about_y(joint_positions - below, angle[:, None])


def bone_rotations(
    joint_positions: Float[np.ndarray, "frames joints 3"], half_turn: Float[np.ndarray, "frames"], body: PoseLayout
) -> Float[np.ndarray, "frames numbers"]:
    """The first two columns of each bone's rotation relative to the previous bone.

    A bone's world rotation is the shortest one from its rest direction; the root's is about Y by twice `half_turn`
    radians. A bone of length zero is not rotated; one opposite to its rest direction is rotated by 180°. Source:
    HumanML3D, common/skeleton.py (`inverse_kinematics_np`).
    """
    # Components apart in memory, which is up to twice as fast.
    x_y_z = np.ascontiguousarray(joint_positions.T)
    bones = np.moveaxis(x_y_z[:, 1:] - x_y_z[:, list(body.skeleton.parents[1:])], 0, -1)
    world = np.moveaxis(np.zeros((4, *x_y_z.shape[1:]), bones.dtype), 0, -1)
    world[0, :, 0], world[0, :, 2] = np.cos(half_turn), np.sin(half_turn)
    world[1:] = kinematics.quaternion_between(np.array(body.bone_directions[1:], bones.dtype)[:, None], bones)
    previous = kinematics.quaternion_conjugate(world[body.previous_bones])
    return kinematics.two_columns(np.swapaxes(kinematics.quaternion_multiply(previous, world[1:]), 0, 1))


def pose_rows(
    yaw_rate: Float[np.ndarray, "rows"],
    root_velocity: Float[np.ndarray, "rows 3"],
    positions: Float[np.ndarray, "rows joints 3"],
    rotations: Float[np.ndarray, "rows columns"],
    velocities: Float[np.ndarray, "rows joints 3"],
    contacts: Bool[np.ndarray, "rows 4"],
) -> Float32[np.ndarray, "rows numbers"]:
    """Rows of 12·J − 1 numbers (`VectorLayout`) of the columns' parts; `positions` are those of `relative_to_root`."""
    rows = len(positions)
    parts = (yaw_rate[:, None], root_velocity[:, ::2], positions[:, 0, 1:2], positions[:, 1:].reshape(rows, -1))
    return np.concatenate((*parts, rotations, velocities.reshape(rows, -1), contacts), axis=1, dtype=np.float32)
