"""`native` pose vectors: the slices of the published vector, with the same meaning at every framerate.

T poses give T rows. Yaw rate in rad/s (of the rotation to Z+, full angle), velocities per second in the heading frame
at the row's own instant, facing smoothed with σ = 1 s and without the published swap of hips, contacts below 0.894 m/s.
Bone rotations are relative to the body's heading; the published ones are relative to the world, so they change when a
clip is rotated. Derivatives are those of the cubic spline through all frames: fourth order in the frame interval;
central differences err by several percent at 20 fps. At framerate F, the yaw rate is 2·F times the published.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np

from motionkit.core import kinematics
from motionkit.core.motion import exchanged
from motionkit.core.shapes import Float, Float32, Float64, Int
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.features import field
from motionkit.features.convention import Instants, InstantVectors, Origin, Values, Vectors, Weight, Yaw
from motionkit.features.layout import (
    SMPL22_LAYOUT,
    PoseLayout,
    across,
    bone_rotations,
    half_angles_to_z,
    layout_of_poses,
    pose_layout,
    pose_rows,
    relative_to_root,
)
from motionkit.fields.motion_field import Poses, Times

SMOOTHING_SECONDS = 1.0
# √0.002 m per frame at 20 fps, the published threshold, on a body with the legs of the published skeleton.
CONTACT_SPEED = 0.894
SECONDS_BETWEEN_STEPS = 1 / 120


def vectors(
    joint_positions: Float[np.ndarray, "frames joints 3"], layout: str, fps: Fraction
) -> Float32[np.ndarray, "frames numbers"]:
    """Pose vectors, one row per pose, of joint positions with any origin and heading.

    Metres for `smpl22`; any unit for `kit21`, whose contact speed is scaled by the length of the leg. Raises
    `ValueError` for another number of joints or fewer than two poses.
    """
    body = layout_of_poses(joint_positions, layout)
    positions = joint_positions.astype(np.float64)
    hips, shoulders = across(positions, body)
    angle = np.unwrap(2 * half_angles_to_z(hips + shoulders, SMOOTHING_SECONDS * float(fps)))
    velocities = _derivative(positions.reshape(len(positions), -1), fps).reshape(positions.shape).astype(np.float32)
    relative = relative_to_root(joint_positions.astype(np.float32, copy=False), angle)
    return pose_rows(
        _derivative(angle[:, None], fps)[:, 0],
        kinematics.rotate_about_y(velocities[:, 0], angle),
        relative,
        bone_rotations(relative, np.zeros(len(positions)), body),
        kinematics.rotate_about_y(velocities, angle[:, None]),
        np.linalg.norm(velocities[:, list(body.contact_joints)], axis=-1) < _contact_speed(positions, body),
    )


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
    root = np.zeros((len(numbers), 3))
    root[:, ::2] = numbers[:, slices.root_velocity]
    root = _integral(kinematics.rotate_about_y(root, -angle), seconds)
    relative = numbers[:, slices.joint_positions].reshape(len(numbers), body.num_joints - 1, 3)
    joints = kinematics.rotate_about_y(relative, -angle[:, None]) + root[:, None]
    root[:, 1:2] = numbers[:, slices.root_height]
    return np.concatenate((root[:, None], joints), axis=1, dtype=np.float32)


@cache
def _mirror_map() -> tuple[Int[np.ndarray, "numbers"], Float32[np.ndarray, "numbers"]]:
    """Source index and sign of each element of a mirrored vector of the 22 joints."""
    slices, joints = SMPL22_LAYOUT.vector, exchanged(SMPL22.num_joints, SMPL22.left_right_pairs)
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


@dataclass(frozen=True)
class NativeVectors:
    """`native` as a convention to learn (`motionkit.features.convention.PoseVectors`).

    Values are the vectors themselves: they mean the same in every window's frame.
    """

    skeleton: Skeleton = SMPL22

    @property
    def num_features(self) -> int:
        """263."""
        return SMPL22_LAYOUT.vector.size

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The root's three velocities, then the other blocks inside which HumanML3D averages its deviations."""
        yaw_rate, velocity, *others = (tuple(range(block.start, block.stop)) for block in SMPL22_LAYOUT.vector)
        return yaw_rate + velocity, *others

    def mirror(self, values: Float32[np.ndarray, "*frames features"]) -> Float32[np.ndarray, "*frames features"]:
        """The vectors of the mirror image (x ← −x, left and right joints exchanged)."""
        source, sign = _mirror_map()
        return np.asarray(values[..., source] * sign)

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
