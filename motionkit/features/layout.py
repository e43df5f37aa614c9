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


def vector_layout(num_joints: int) -> VectorLayout:
    """Slices of the pose vector of a body with `num_joints` joints."""
    from motionkit.io.humanml3d import vector_blocks  # deferred: `field` vectors need no slices

    return VectorLayout(num_joints, *vector_blocks(num_joints))


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
# The terms of conj(a)·b after a_w·b: component, factor of a, factor of b, whether the term is added.
_CONJUGATE_PRODUCT = (
    *((0, 1, 1, True), (0, 2, 2, True), (0, 3, 3, True)),
    *((1, 1, 0, False), (1, 2, 3, False), (1, 3, 2, True)),
    *((2, 2, 0, False), (2, 3, 1, False), (2, 1, 3, True)),
    *((3, 3, 0, False), (3, 1, 2, False), (3, 2, 1, True)),
)


@dataclass(frozen=True, eq=False)
class BoneTree:
    """The bones of a layout, one per joint 1 … J − 1, named after the joint they end in.

    `start` is the joint a bone starts at; `previous` is the bone before it in its chain, or 0, the root, for the first
    bone of every chain, the arms' included; `direction` [3, J, 1] is the rest direction u, along an axis, Z+ for the
    root; `sideways` is an axis perpendicular to it. Since u is along an axis, element i of the quaternion
    (u·v, u × v) of a direction v, flattened over components and joints, is element `source[i]` of v times `sign[i]`.
    `runs` are (joints, parents) as slices, with every parent before its children.
    """

    runs: tuple[tuple[slice, slice], ...]
    start: Int[np.ndarray, "bones"]
    previous: Int[np.ndarray, "bones"]
    direction: Float32[np.ndarray, "3 joints 1"]
    sideways: Float32[np.ndarray, "3 joints 1"]
    source: Int[np.ndarray, "numbers"]
    sign: Float32[np.ndarray, "numbers 1"]


@cache
def bone_tree(layout_name: str) -> BoneTree:
    """The bones of a layout in the published chains."""
    layout = LAYOUTS[layout_name]
    bones = sorted((chain[i], chain[i - 1], i) for chain in layout.chains for i in range(1, len(chain)))
    direction = np.array(layout.bone_directions, dtype=np.float32)
    direction[0] = (0, 0, 1)
    # [joint, quaternion component, component of v]: the linear map v → (u·v, u × v), at most one element per row.
    product = np.stack((direction, *np.cross(direction[:, None], np.eye(3)).transpose(2, 0, 1)), axis=1)
    place = np.abs(product).argmax(axis=2)
    sign = np.take_along_axis(product, place[:, :, None], axis=2)[:, :, 0]
    source = place * len(direction) + np.arange(len(direction))[:, None]
    return BoneTree(
        runs=_runs([start for _, start, _ in bones]),
        start=np.array([start for _, start, _ in bones]),
        previous=np.array([start if place > 1 else 0 for _, start, place in bones]),
        direction=direction.T[:, :, None].copy(),
        sideways=np.roll(direction, 2, axis=1).T[:, :, None].copy(),
        source=source.T.reshape(-1),
        sign=sign.T.reshape(-1, 1).astype(np.float32),
    )


def _runs(starts: list[int]) -> tuple[tuple[slice, slice], ...]:
    """Runs of consecutive joints whose parents are consecutive, or one joint, and outside the run."""
    runs: list[tuple[slice, slice]] = []
    joint = 1
    while joint <= len(starts):
        parents = starts[joint - 1 :]
        in_a_row = next((i for i, parent in enumerate(parents) if parent != parents[0] + i), len(parents))
        in_a_row = min(in_a_row, joint - parents[0])
        alike = next((i for i, parent in enumerate(parents) if parent != parents[0]), len(parents))
        length = max(in_a_row, alike)
        above = slice(parents[0], parents[0] + (in_a_row if in_a_row >= alike else 1))
        runs.append((slice(joint, joint + length), above))
        joint += length
    return tuple(runs)


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
    length = _squared_length(toward, tree.direction)
    toward /= np.sqrt(length, out=length)
    world = toward.reshape(-1, toward.shape[2]).take(tree.source, axis=0)
    world *= tree.sign
    world = world.reshape(4, *toward.shape[1:])
    world[0] += 1
    world[:, 0] = 0
    world[0, 0], world[2, 0] = np.cos(half_turn), np.sin(half_turn)
    squared = _squared_length(world[1:], tree.sideways, start=world[0])
    relative = _relative(world.take(tree.previous, axis=1), world[:, 1:])
    _fill_columns(relative, 2 / (squared.take(tree.previous, axis=0) * squared[1:]), out)


def _squared_length(
    vectors: Float32[np.ndarray, "3 joints frames"],
    fallback: Float32[np.ndarray, "3 joints 1"],
    start: Float32[np.ndarray, "joints frames"] | None = None,
) -> Float32[np.ndarray, "joints frames"]:
    """Squared lengths of vectors, or of quaternions if their real parts are given as `start`.

    Zero vectors are replaced by the fallback, a unit vector, in place.
    """
    squared = np.square(vectors[0])
    squared += np.square(vectors[1])
    squared += np.square(vectors[2])
    if start is not None:
        squared += np.square(start)
    if squared.min() < _NO_LENGTH:
        empty = squared < _NO_LENGTH
        np.copyto(vectors, fallback, where=empty)
        squared[empty] = 1.0
    return np.asarray(squared)


def _relative(
    before: Float32[np.ndarray, "4 bones frames"], own: Float32[np.ndarray, "4 bones frames"]
) -> Float32[np.ndarray, "4 bones frames"]:
    """The quaternion product of the conjugate of `before` and `own`."""
    result = before[0] * own
    product = np.empty_like(result[0])
    for component, i, j, add in _CONJUGATE_PRODUCT:
        np.multiply(before[i], own[j], out=product)
        (np.add if add else np.subtract)(result[component], product, out=result[component])
    return np.asarray(result)


def _fill_columns(
    quaternions: Float32[np.ndarray, "4 bones frames"],
    gain: Float32[np.ndarray, "bones frames"],
    out: Float32[np.ndarray, "bones 6 frames"],
) -> None:
    """Write the first two columns of the rotation matrices of quaternions; `gain` is 2 over their squared length."""
    w, x, y, z = quaternions
    gain_x, gain_y, gain_z = gain * quaternions[1:]
    xy, zw = gain_x * y, gain_z * w
    zz = gain_z * z
    np.subtract(1, gain_y * y + zz, out=out[:, 0])
    np.add(xy, zw, out=out[:, 1])
    np.subtract(gain_x * z, gain_y * w, out=out[:, 2])
    np.subtract(xy, zw, out=out[:, 3])
    np.subtract(1, gain_x * x + zz, out=out[:, 4])
    np.add(gain_y * z, gain_x * w, out=out[:, 5])
