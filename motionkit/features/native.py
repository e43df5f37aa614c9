"""`native` pose vectors: the slices of the published vector, with the same meaning at every framerate.

T poses give T rows. Yaw rate in rad/s (of the rotation to Z+, full angle), velocities per second in the heading frame
at the row's own instant, facing smoothed with σ = 1 s and without the published swap of hips, contacts below 0.894 m/s.
Bone rotations are relative to the body's heading; the published ones are relative to the world, so they change when a
clip is rotated. Derivatives are those of the cubic spline through all frames: fourth order in the frame interval;
central differences err by several percent at 20 fps. At framerate F, the yaw rate is 2·F times the published.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np

from motionkit.core.motion import exchanged
from motionkit.core.shapes import Float, Float32, Float64, Int
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.features import field
from motionkit.features.convention import Instants, InstantVectors, Origin, Values, Vectors, Weight, Yaw
from motionkit.features.layout import (
    SMPL22_LAYOUT,
    PoseLayout,
    VectorLayout,
    bone_tree,
    pose_layout,
    rotations_6d,
    smooth,
    to_z_half_angle,
)
from motionkit.fields.motion_field import Poses, Times

Joints = Float32[np.ndarray, "3 joints rows"]
PerRow = Float32[np.ndarray, "rows"]
RowsOut = Float32[np.ndarray, "numbers rows"]


def turn(
    vectors: Float32[np.ndarray, "3 *rest"], cosine: PerRow, sine: PerRow, out: Float32[np.ndarray, "2 *rest"]
) -> None:
    """Write the x and z of vectors [x, y, z] rotated about Y by the angle of the given cosine and sine."""
    np.add(cosine * vectors[0], sine * vectors[2], out=out[0])
    np.subtract(cosine * vectors[2], sine * vectors[0], out=out[1])


def fill_positions(rows: RowsOut, joints: Joints, cosine: PerRow, sine: PerRow, slices: VectorLayout) -> None:
    """Write root height and root-relative joint positions, rotated so that each pose faces Z+."""
    num_rows = joints.shape[2]
    rows[slices.root_height] = joints[1, 0]
    relative = rows[slices.joint_positions].reshape(slices.num_joints - 1, 3, num_rows)
    x, z = joints[0, 1:] - joints[0, 0], joints[2, 1:] - joints[2, 0]
    np.add(cosine * x, sine * z, out=relative[:, 0])
    relative[:, 1] = joints[1, 1:]
    np.subtract(cosine * z, sine * x, out=relative[:, 2])


def fill_joint_velocities(rows: RowsOut, change: Joints, cosine: PerRow, sine: PerRow, slices: VectorLayout) -> None:
    """Write the joints' displacements or velocities in the heading frame."""
    velocities = rows[slices.joint_velocities].reshape(slices.num_joints, 3, change.shape[2])
    turn(change, cosine, sine, out=velocities[:, ::2].transpose(1, 0, 2))
    velocities[:, 1] = change[1]


CONVENTION = "native"
SMOOTHING_SECONDS = 1.0
# √0.002 m per frame at 20 fps, the published threshold, on a body with the legs of the published skeleton.
CONTACT_SPEED = 0.894
SECONDS_BETWEEN_STEPS = 1 / 120
_FRAMES_AT_ONCE = 256


def vectors(
    joint_positions: Float[np.ndarray, "frames joints 3"], layout: str, fps: Fraction
) -> Float32[np.ndarray, "frames numbers"]:
    """Pose vectors, one row per pose, of joint positions with any origin and heading.

    Metres for `smpl22`; any unit for `kit21`, whose contact speed is scaled by the length of the leg. Raises
    `ValueError` for another number of joints or fewer than two poses.
    """
    body = pose_layout(layout)
    num_frames, num_joints = joint_positions.shape[:2]
    if num_joints != body.num_joints or num_frames < 2:
        raise ValueError(
            f"{layout} vectors need at least 2 poses of {body.num_joints} joints, not {num_frames} of {num_joints}"
        )
    positions = joint_positions.astype(np.float64)
    angle = _angle_to_z(positions, body, fps)
    velocity = _derivative(positions.reshape(num_frames, -1), fps).astype(np.float32).reshape(positions.shape)
    rate = _derivative(angle[:, None], fps)[:, 0].astype(np.float32)
    contact_speed = _contact_speed(positions, body)
    result = np.empty((num_frames, body.vector.size), dtype=np.float32)
    for start in range(0, num_frames, _FRAMES_AT_ONCE):
        block = slice(start, min(start + _FRAMES_AT_ONCE, num_frames))
        joints = joint_positions[block].transpose(2, 1, 0).astype(np.float32, order="C")
        speeds = velocity[block].transpose(2, 1, 0).copy()
        result[block] = _block(joints, speeds, angle[block], rate[block], body, contact_speed).T
    return result


def positions_at(
    vectors: Float[np.ndarray, "times numbers"], layout: str, seconds: Float64[np.ndarray, "times"]
) -> Float32[np.ndarray, "times joints 3"]:
    """Joint positions from vectors at ascending times: the first root is above the origin, its smoothed facing Z+.

    Heading and root path are integrated over time by the trapezoidal rule. Raises `ValueError` for vectors whose length
    differs from the layout's.
    """
    body = pose_layout(layout)
    slices = body.vector
    if vectors.shape[1] != slices.size:
        raise ValueError(f"{layout} vectors have {slices.size} numbers, these have {vectors.shape[1]}")
    numbers = vectors.astype(np.float64)
    angle = _integral(numbers[:, slices.root_yaw_velocity], seconds)[:, 0]
    path = _integral(_turned_back(numbers[:, slices.root_velocity], angle), seconds)
    relative = numbers[:, slices.joint_positions].reshape(len(numbers), body.num_joints - 1, 3)
    result = np.empty((len(numbers), body.num_joints, 3))
    result[:, 0, ::2], result[:, 0, 1] = path, numbers[:, slices.root_height][:, 0]
    result[:, 1:, ::2] = _turned_back(relative[..., ::2], angle[:, None]) + path[:, None]
    result[:, 1:, 1] = relative[..., 1]
    return result.astype(np.float32)


def mirrored(vectors: Float[np.ndarray, "*poses numbers"], layout: str) -> Float[np.ndarray, "*poses numbers"]:
    """The vectors of the mirror image (x ← −x, left and right joints exchanged)."""
    source, sign = _mirror_map(layout)
    return np.asarray(vectors[..., source] * sign)


@lru_cache(maxsize=4)
def _mirror_map(layout: str) -> tuple[Int[np.ndarray, "numbers"], Float32[np.ndarray, "numbers"]]:
    """Source index and sign of each element of a mirrored vector."""
    body = pose_layout(layout)
    slices, joints = body.vector, exchanged(body.num_joints, body.skeleton.left_right_pairs)
    source, sign = np.arange(slices.size), np.ones(slices.size, np.float32)
    sign[slices.root_yaw_velocity] = -1.0
    sign[slices.root_velocity] = (-1.0, 1.0)
    # The reflection M = diag(−1, 1, 1) maps a bone's rotation R to M·R·M; 6D numbers are R's first two columns.
    for block, order, signs in (
        (slices.joint_positions, joints[1:] - 1, (-1, 1, 1)),
        (slices.joint_rotations, joints[1:] - 1, (1, -1, -1, -1, 1, 1)),
        (slices.joint_velocities, joints, (-1, 1, 1)),
        (slices.contacts, np.array([2, 3, 0, 1]), (1,)),
    ):
        source[block] = source[block].reshape(len(order), -1)[order].reshape(-1)
        sign[block] = np.tile(np.array(signs, np.float32), len(order))
    return source, sign


def _angle_to_z(
    positions: Float64[np.ndarray, "frames joints 3"], body: PoseLayout, fps: Fraction
) -> Float64[np.ndarray, "frames"]:
    """The angle about Y, continuous in time, from each smoothed facing to Z+."""
    facing = body.facing
    across = positions[:, facing.right_hip] - positions[:, facing.left_hip]
    across = across + positions[:, facing.right_shoulder] - positions[:, facing.left_shoulder]
    # A body lying on its side has a short horizontal lateral axis, and so little weight in the smoothed facing.
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    forward = np.stack((across[:, 2], -across[:, 0]), axis=-1) / np.where(length > 0, length, 1.0)
    return np.unwrap(2 * to_z_half_angle(smooth(forward, SMOOTHING_SECONDS * float(fps))))


def _block(
    joints: Joints,
    velocity: Joints,
    angle: Float64[np.ndarray, "rows"],
    rate: PerRow,
    body: PoseLayout,
    contact_speed: float,
) -> RowsOut:
    slices = body.vector
    result = np.empty((slices.size, len(angle)), dtype=np.float32)
    result[slices.root_yaw_velocity] = rate
    cosine, sine = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    turn(velocity[:, 0], cosine, sine, out=result[slices.root_velocity])
    fill_positions(result, joints, cosine, sine, slices)
    local = np.zeros_like(joints)
    local[1, 0] = joints[1, 0]
    local[:, 1:] = result[slices.joint_positions].reshape(body.num_joints - 1, 3, -1).transpose(1, 0, 2)
    rotations = result[slices.joint_rotations].reshape(body.num_joints - 1, 6, -1)
    rotations_6d(local, np.zeros(len(angle), np.float32), bone_tree(body.name), out=rotations)
    fill_joint_velocities(result, velocity, cosine, sine, slices)
    x, y, z = velocity.take(body.contact_joints, axis=1)
    result[slices.contacts] = x * x + y * y + z * z < contact_speed**2
    return result


def _contact_speed(positions: Float64[np.ndarray, "frames joints 3"], body: PoseLayout) -> float:
    """The contact threshold in the positions' unit per second."""
    if body is SMPL22_LAYOUT:
        return CONTACT_SPEED
    published = np.linalg.norm(SMPL22_LAYOUT.skeleton.offsets[list(SMPL22_LAYOUT.leg_joints)], axis=-1).sum()
    bones = [positions[:, joint] - positions[:, body.skeleton.parents[joint]] for joint in body.leg_joints]
    leg = sum(float(np.linalg.norm(bone, axis=-1).mean()) for bone in bones)
    return CONTACT_SPEED * leg / float(published)


def _derivative(values: Float64[np.ndarray, "frames columns"], fps: Fraction) -> Float64[np.ndarray, "frames columns"]:
    """Time derivative per second at every frame, of the cubic spline through all frames (not-a-knot ends)."""
    from scipy.interpolate import CubicSpline

    frames = np.arange(len(values), dtype=np.float64)
    return np.asarray(CubicSpline(frames, values)(frames, 1) * float(fps))


def _integral(
    rates: Float64[np.ndarray, "frames columns"], seconds: Float64[np.ndarray, "frames"]
) -> Float64[np.ndarray, "frames columns"]:
    steps = (rates[1:] + rates[:-1]) * (0.5 * np.diff(seconds)[:, None])
    return np.concatenate((np.zeros_like(rates[:1]), np.cumsum(steps, axis=0)))


def _turned_back(
    horizontal: Float64[np.ndarray, "*rest 2"], angle: Float64[np.ndarray, "*angles"]
) -> Float64[np.ndarray, "*rest 2"]:
    cosine, sine = np.cos(angle), np.sin(angle)
    x, z = horizontal[..., 0], horizontal[..., 1]
    return np.stack((cosine * x - sine * z, sine * x + cosine * z), axis=-1)


@dataclass(frozen=True)
class NativeVectors:
    """`native` as a convention to learn (`motionkit.features.convention.PoseVectors`).

    Values are the vectors themselves: they mean the same in every window's frame.
    """

    @property
    def skeleton(self) -> Skeleton:
        """The 22-joint layout."""
        return SMPL22

    @property
    def num_features(self) -> int:
        """263."""
        return SMPL22_LAYOUT.vector.size

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The root's three velocities, then the other blocks inside which HumanML3D averages its deviations."""
        yaw_rate, velocity, *others = (tuple(range(block.start, block.stop)) for block in SMPL22_LAYOUT.vector.blocks)
        return yaw_rate + velocity, *others

    def mirror(self, values: Float32[np.ndarray, "*frames features"]) -> Float32[np.ndarray, "*frames features"]:
        """The vectors of the mirrored motion."""
        return mirrored(values, SMPL22.name)

    def between(self, before: Values, after: Values, weight: Weight) -> Values:
        """Linear, number by number."""
        return np.asarray(before + weight[..., None] * (after - before))

    def encode(self, values: Values, yaw: Yaw, origin: Origin) -> Vectors:
        """Unchanged: they are vectors already."""
        return values

    def instants(self, seconds: Times) -> Instants:
        """All from the window's start, no more than 1/120 s apart: the path is integrated over them."""
        end = float(seconds.max(initial=0.0))
        return np.union1d(np.arange(0.0, end, SECONDS_BETWEEN_STEPS), seconds)

    def decode(self, vectors: InstantVectors, instants: Instants, seconds: Times) -> Poses:
        """Heading and path integrated over the time stamps; then into the frame in which the first pose faces Z+."""
        world = positions_at(vectors, SMPL22.name, instants)
        yaw, origin = field.window_frame(world[:1])
        return Poses(field.to_window(world[None], yaw, origin)[0, np.searchsorted(instants, seconds)])
