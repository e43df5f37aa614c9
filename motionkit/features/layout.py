"""Joint layouts of the pose-vector conventions: facing joints, chains, slices of the vector, rotations of bones.

Arrays of bone rotations have the shape [component, joint, frame], so that operations run along contiguous time.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Float32, Float64, Int
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton


@dataclass(frozen=True)
class FacingJoints:
    """The four joints (hips and shoulders) whose lateral axes give the facing direction."""

    right_hip: int
    left_hip: int
    right_shoulder: int
    left_shoulder: int


@dataclass(frozen=True)
class VectorLayout:
    """Slices of the published pose vector of 12·J − 1 numbers (HumanML3D, motion_representation.ipynb).

    `root_yaw_velocity` 1 · `root_velocity` 2 (x, z) · `root_height` 1 · `joint_positions` 3(J − 1) · `joint_rotations`
    6(J − 1) · `joint_velocities` 3J · `contacts` 4 (left ankle, left toe, right ankle, right toe).
    """

    num_joints: int
    root_yaw_velocity: slice
    root_velocity: slice
    root_height: slice
    joint_positions: slice
    joint_rotations: slice
    joint_velocities: slice
    contacts: slice

    @property
    def size(self) -> int:
        """Numbers per pose: 263 for 22 joints, 251 for 21."""
        return 12 * self.num_joints - 1

    @property
    def blocks(self) -> tuple[slice, ...]:
        """The seven blocks inside which HumanML3D averages its standard deviation."""
        _, *blocks = vars(self).values()
        return tuple(blocks)


@dataclass(frozen=True, eq=False)
class PoseLayout:
    """A joint layout for which pose vectors are defined.

    `chains` are the kinematic chains of the published inverse kinematics, each starting at a joint of an earlier one or
    at the root; `bone_directions` [J, 3] are the rest directions of the bones that end in each joint; `leg_joints` are
    the two bones of one leg whose lengths give the body's scale; `contact_threshold` is the squared displacement per
    frame, in the published files' unit, below which a foot is in contact.
    """

    skeleton: Skeleton
    facing: FacingJoints
    chains: tuple[tuple[int, ...], ...]
    bone_directions: tuple[tuple[int, int, int], ...]
    leg_joints: tuple[int, int]
    contact_threshold: float

    @cached_property
    def vector(self) -> VectorLayout:
        """Slices of its pose vectors."""
        from motionkit.io.humanml3d import vector_blocks  # deferred: `field` vectors need no slices

        return VectorLayout(self.num_joints, *vector_blocks(self.num_joints))

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


_X, _Y, _Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
_MX, _MY, _NONE = (-1, 0, 0), (0, -1, 0), (0, 0, 0)

# Chains, directions, facing joints and thresholds: HumanML3D, paramUtil.py and motion_representation.ipynb.
SMPL22_LAYOUT = PoseLayout(
    skeleton=SMPL22,
    facing=FacingJoints(right_hip=2, left_hip=1, right_shoulder=17, left_shoulder=16),
    chains=((0, 2, 5, 8, 11), (0, 1, 4, 7, 10), (0, 3, 6, 9, 12, 15), (9, 14, 17, 19, 21), (9, 13, 16, 18, 20)),
    bone_directions=(_NONE, _X, _MX, _Y, _MY, _MY, _Y, _MY, _MY, _Y, _Z, _Z, _Y, _X, _MX, _Z, *(_MY,) * 6),
    leg_joints=(5, 8),
    contact_threshold=0.002,
)

KIT21_LAYOUT = PoseLayout(
    skeleton=KIT21,
    facing=FacingJoints(right_hip=11, left_hip=16, right_shoulder=5, left_shoulder=8),
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


def layout_of(num_joints: int) -> PoseLayout:
    """The layout with this many joints (22 or 21); raises `UsageError` for other counts."""
    for layout in LAYOUTS.values():
        if layout.num_joints == num_joints:
            return layout
    known = ", ".join(f"{layout.name} ({layout.num_joints} joints)" for layout in LAYOUTS.values())
    raise UsageError(f"no joint layout has {num_joints} joints; map the motion to one of {known} first")


def facing_direction(
    joint_positions: Float[np.ndarray, "*poses joints 3"], facing: FacingJoints
) -> Float[np.ndarray, "*poses 2"]:
    """Horizontal facing direction (x, z) of each pose, not normalised: Y × ((R − L hip) + (R − L shoulder))."""
    across = (
        joint_positions[..., facing.right_hip, :]
        - joint_positions[..., facing.left_hip, :]
        + joint_positions[..., facing.right_shoulder, :]
        - joint_positions[..., facing.left_shoulder, :]
    )
    return np.stack((across[..., 2], -across[..., 0]), axis=-1)


def smooth(values: Float[np.ndarray, "frames columns"], sigma_frames: float) -> Float64[np.ndarray, "frames columns"]:
    """Gaussian smoothing along time, with the end values repeated beyond both ends.

    The kernel is sampled at whole frames and truncated at 4σ, as in `scipy.ndimage.gaussian_filter1d(mode="nearest")`,
    which takes ten times as long at 120 fps.
    """
    reach = int(4.0 * sigma_frames + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_frames) ** 2)
    padded = np.pad(values.astype(np.float64), ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, kernel / kernel.sum(), mode="valid") for column in padded.T], axis=-1)


def to_z_half_angle(direction: Float[np.ndarray, "frames 2"]) -> Float64[np.ndarray, "frames"]:
    """Half the angle about Y, in (−π/2, π/2], from each horizontal direction (x, z) to Z+."""
    return np.asarray(0.5 * np.arctan2(-direction[:, 0], direction[:, 1]), dtype=np.float64)


_NO_LENGTH = 1e-14


@dataclass(frozen=True, eq=False)
class BoneTree:
    """The bones of a layout, one per joint 1 … J − 1, named after the joint they end in.

    `start` is the joint a bone starts at; `previous` is the bone before it in its chain, or 0, the root, for the first
    bone of every chain, the arms' included; `direction` [3, J, 1] is the rest direction u, along an axis, Z+ for the
    root; `sideways` is an axis perpendicular to it.
    """

    start: Int[np.ndarray, "bones"]
    previous: Int[np.ndarray, "bones"]
    direction: Float32[np.ndarray, "3 joints 1"]
    sideways: Float32[np.ndarray, "3 joints 1"]


@cache
def bone_tree(layout_name: str) -> BoneTree:
    """The bones of a layout in the published chains."""
    layout = LAYOUTS[layout_name]
    bones = sorted((chain[i], chain[i - 1], i) for chain in layout.chains for i in range(1, len(chain)))
    direction = np.array(layout.bone_directions, dtype=np.float32)
    direction[0] = (0, 0, 1)
    return BoneTree(
        start=np.array([start for _, start, _ in bones]),
        previous=np.array([start if place > 1 else 0 for _, start, place in bones]),
        direction=direction.T[:, :, None].copy(),
        sideways=np.roll(direction, 2, axis=1).T[:, :, None].copy(),
    )


def rotations_6d(
    joints: Float32[np.ndarray, "3 joints frames"],
    half_turn: Float32[np.ndarray, "frames"],
    tree: BoneTree,
    out: Float32[np.ndarray, "bones 6 frames"],
) -> None:
    """Write the first two columns of each bone's rotation relative to the previous bone.

    A bone's world rotation is the shortest one from its rest direction u to its direction v: the quaternion
    (1 + u·v, u × v). The root's is a rotation about Y by twice `half_turn` radians. A bone of length zero points along
    its rest direction; one that points the opposite way is rotated by 180°. Source: HumanML3D, common/skeleton.py
    (`inverse_kinematics_np`).
    """
    toward = np.empty_like(joints)
    toward[:, 0] = tree.direction[:, 0]
    np.subtract(joints[:, 1:], joints.take(tree.start, axis=1), out=toward[:, 1:])
    toward /= np.sqrt(_squared_length(toward, tree.direction))
    world = np.empty((4, *toward.shape[1:]), np.float32)
    world[0] = 1 + (tree.direction * toward).sum(axis=0)
    world[1:] = np.cross(tree.direction, toward, axis=0)
    world[:, 0] = 0
    world[0, 0], world[2, 0] = np.cos(half_turn), np.sin(half_turn)
    squared = _squared_length(world, tree.sideways)
    # The conjugate of the previous bone's quaternion times the bone's own.
    w0, x0, y0, z0 = world.take(tree.previous, axis=1)
    w1, x1, y1, z1 = world[:, 1:]
    w = w0 * w1 + x0 * x1 + y0 * y1 + z0 * z1
    x = w0 * x1 - x0 * w1 - y0 * z1 + z0 * y1
    y = w0 * y1 - y0 * w1 - z0 * x1 + x0 * z1
    z = w0 * z1 - z0 * w1 - x0 * y1 + y0 * x1
    gain = 2 / (squared.take(tree.previous, axis=0) * squared[1:])
    xy, zw, zz = gain * x * y, gain * z * w, gain * z * z
    np.subtract(1, gain * y * y + zz, out=out[:, 0])
    np.add(xy, zw, out=out[:, 1])
    np.subtract(gain * x * z, gain * y * w, out=out[:, 2])
    np.subtract(xy, zw, out=out[:, 3])
    np.subtract(1, gain * x * x + zz, out=out[:, 4])
    np.add(gain * y * z, gain * x * w, out=out[:, 5])


def _squared_length(
    vectors: Float32[np.ndarray, "components joints frames"], fallback: Float32[np.ndarray, "3 joints 1"]
) -> Float32[np.ndarray, "joints frames"]:
    """Squared lengths of vectors or quaternions; x, y, z of zeros are replaced by the fallback, a unit vector."""
    squared = np.square(vectors[-3:]).sum(axis=0)
    if len(vectors) == 4:
        squared += np.square(vectors[0])
    empty = squared < _NO_LENGTH
    np.copyto(vectors[-3:], fallback, where=empty)
    squared[empty] = 1.0
    return np.asarray(squared)
