"""From channels and feet to rotations: the trunk and arms by angles, the legs by two-bone inverse kinematics."""

import numpy as np
from jaxtyping import Float64

from motionkit.core.kinematics import forward_kinematics_matrices, matrix_to_quaternion
from motionkit.core.skeleton import SMPL22
from motionkit.fields.motion_field import Poses
from motionkit.synthetic.bodies import Body
from motionkit.synthetic.feet import FootPath
from motionkit.synthetic.script import SIDES, Trajectory, turned

Channels = dict[str, Float64[np.ndarray, " times"]]

STANDING_STRETCH = 0.985  # of a leg's length when standing upright
PLANTED_STRETCH = 0.986  # maximum for a planted leg; the pelvis is kept low enough for it
STRETCH_MARGIN = 0.010  # width of the smooth saturation of a leg's length
SOFT_MINIMUM_PER_METRE = 220.0
SWING_FLEXION = 0.09  # shortening of a leg in the middle of a swing
FREED_BY_SWING = 0.08  # metres by which a leg in the air relaxes its limit on the pelvis' height
JOINT = {name: index for index, name in enumerate(SMPL22.joint_names)}


def about(axis: str, angle: Float64[np.ndarray, " times"]) -> Float64[np.ndarray, "times 3 3"]:
    """Rotation matrices about a coordinate axis."""
    i, j, k = {"x": (0, 1, 2), "y": (1, 2, 0), "z": (2, 0, 1)}[axis]
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[:, i, i] = 1.0
    matrix[:, j, j] = matrix[:, k, k] = np.cos(angle)
    matrix[:, k, j] = np.sin(angle)
    matrix[:, j, k] = -matrix[:, k, j]
    return matrix


def pose(
    body: Body,
    trajectory: Trajectory,
    feet: dict[str, FootPath],
    channels: Channels,
    times: Float64[np.ndarray, " times"],
) -> Poses:
    """Joint positions, local rotations and root path at some times."""
    local = np.broadcast_to(np.eye(3), (times.size, SMPL22.num_joints, 3, 3)).copy()
    heading = trajectory.heading(times)
    local[:, 0] = (
        about("y", heading + channels["pelvis_yaw"])
        @ about("x", channels["pelvis_pitch"])
        @ about("z", channels["pelvis_roll"])
    )
    _pose_trunk(local, channels)
    for side in SIDES:
        _pose_arm(local, side, channels)
    ankles = {side: _ankle(body, side, feet[side], heading, channels) for side in SIDES}
    root = _pelvis(body, trajectory, feet, ankles, local[:, 0], heading, channels, times)
    for side in SIDES:
        _pose_leg(local, side, body, root, ankles[side], feet[side], heading, channels)
    positions, _ = forward_kinematics_matrices(local, root, body.skeleton)
    return Poses(
        joint_positions=positions.astype(np.float32),
        local_rotations=matrix_to_quaternion(local).astype(np.float32),
        root_translation=root.astype(np.float32),
    )


def _pose_trunk(local: Float64[np.ndarray, "times 22 3 3"], channels: Channels) -> None:
    bend = about("y", channels["spine_yaw"] / 3.0) @ about("x", channels["spine_pitch"] / 3.0)
    bend = bend @ about("z", channels["spine_roll"] / 3.0)
    nod = about("y", channels["head_yaw"] / 2.0) @ about("x", channels["head_pitch"] / 2.0)
    nod = nod @ about("z", channels["head_roll"] / 2.0)
    for joint in ("spine1", "spine2", "spine3"):
        local[:, JOINT[joint]] = bend
    for joint in ("neck", "head"):
        local[:, JOINT[joint]] = nod


def _pose_arm(local: Float64[np.ndarray, "times 22 3 3"], side: str, channels: Channels) -> None:
    """Elevation from hanging, in a vertical plane at an azimuth (0 forward, π/2 to the side), twist, elbow flexion."""
    sign = 1.0 if side == "left" else -1.0
    azimuth = sign * channels[f"{side}_arm_azimuth"]
    raised = about("y", azimuth) @ about("x", -channels[f"{side}_arm_elevation"]) @ about("y", -azimuth)
    local[:, JOINT[f"{side}_shoulder"]] = raised @ about("y", sign * channels[f"{side}_arm_twist"])
    local[:, JOINT[f"{side}_elbow"]] = about("x", -channels[f"{side}_elbow"])
    local[:, JOINT[f"{side}_collar"]] = about("z", sign * channels[f"{side}_shrug"])


def _ankle(
    body: Body, side: str, foot: FootPath, heading: Float64[np.ndarray, " times"], channels: Channels
) -> Float64[np.ndarray, "times 3"]:
    """The ankle's target: the flat foot's ankle, rotated about the planted toe as the heel rises."""
    sign = 1.0 if side == "left" else -1.0
    toe = body.skeleton.offsets[JOINT[f"{side}_foot"]].astype(np.float64)
    flat = turned(np.broadcast_to(toe, foot.base.shape), foot.yaw)
    tipped = turned((about("x", foot.heel_rise) @ toe), foot.yaw)
    gesture = np.stack(
        (sign * channels[f"{side}_foot_out"], channels[f"{side}_foot_lift"], channels[f"{side}_foot_forward"]), axis=-1
    )
    return np.asarray(foot.base + flat - tipped + turned(gesture, heading))


def _pelvis(
    body: Body,
    trajectory: Trajectory,
    feet: dict[str, FootPath],
    ankles: dict[str, Float64[np.ndarray, "times 3"]],
    rotation: Float64[np.ndarray, "times 3 3"],
    heading: Float64[np.ndarray, " times"],
    channels: Channels,
    times: Float64[np.ndarray, " times"],
) -> Float64[np.ndarray, "times 3"]:
    """The pelvis above its path, at the desired height or lower, so that planted feet stay within reach."""
    aside = np.stack((channels["pelvis_left"], np.zeros(times.size), channels["pelvis_forward"]), axis=-1)
    root: Float64[np.ndarray, "times 3"] = trajectory.position(times) + turned(aside, heading)
    upright = body.ankle_height + STANDING_STRETCH * body.leg_length + body.hip_drop
    heights = [upright - channels["pelvis_drop"]]
    for side in SIDES:
        hip = rotation @ body.skeleton.offsets[JOINT[f"{side}_hip"]].astype(np.float64)
        apart = np.hypot(*(ankles[side] - root - hip)[:, [0, 2]].T)
        reach = np.sqrt(np.maximum((PLANTED_STRETCH * body.leg_length) ** 2 - apart**2, 1e-4))
        heights.append(ankles[side][:, 1] + reach - hip[:, 1] + FREED_BY_SWING * feet[side].airborne)
    root[:, 1] = _soft_minimum(np.stack(heights))
    return root


def _soft_minimum(values: Float64[np.ndarray, "terms times"]) -> Float64[np.ndarray, " times"]:
    """A smooth lower bound of the minimum over terms."""
    least = values.min(axis=0)
    weights = np.exp(-SOFT_MINIMUM_PER_METRE * (values - least)).sum(axis=0)
    return np.asarray(least - np.log(weights) / SOFT_MINIMUM_PER_METRE)


def _pose_leg(
    local: Float64[np.ndarray, "times 22 3 3"],
    side: str,
    body: Body,
    root: Float64[np.ndarray, "times 3"],
    ankle: Float64[np.ndarray, "times 3"],
    foot: FootPath,
    heading: Float64[np.ndarray, " times"],
    channels: Channels,
) -> None:
    sign = 1.0 if side == "left" else -1.0
    bones = body.skeleton.offsets.astype(np.float64)
    thigh, shin = -bones[JOINT[f"{side}_knee"], 1], -bones[JOINT[f"{side}_ankle"], 1]
    hip = root + local[:, 0] @ bones[JOINT[f"{side}_hip"]]
    reach, down = _within_reach(ankle - hip, thigh + shin, foot.airborne)
    # The knee's axis points to the body's left, half way between pelvis and foot, and is perpendicular to the leg.
    knee_yaw = heading + (foot.yaw - heading) / 2.0 + channels["pelvis_yaw"] / 2.0 + sign * channels[f"{side}_knee_out"]
    hinge = turned(np.broadcast_to([1.0, 0.0, 0.0], hip.shape), knee_yaw)
    hinge = hinge - np.sum(hinge * down, axis=-1, keepdims=True) * down
    hinge /= np.linalg.norm(hinge, axis=-1, keepdims=True)
    forward = np.cross(hinge, -down)
    cosine = (thigh**2 + reach**2 - shin**2) / (2.0 * thigh * reach)
    knee = hip + thigh * (cosine[:, None] * down + np.sqrt(1.0 - cosine**2)[:, None] * forward)
    thigh_frame = _frame(hinge, (hip - knee) / thigh)
    shin_frame = _frame(hinge, (knee - hip - reach[:, None] * down) / shin)
    foot_frame = about("y", foot.yaw) @ about("x", foot.heel_rise - foot.toe_up + channels[f"{side}_foot_pitch"])
    local[:, JOINT[f"{side}_hip"]] = np.swapaxes(local[:, 0], -1, -2) @ thigh_frame
    local[:, JOINT[f"{side}_knee"]] = np.swapaxes(thigh_frame, -1, -2) @ shin_frame
    local[:, JOINT[f"{side}_ankle"]] = np.swapaxes(shin_frame, -1, -2) @ foot_frame


def _within_reach(
    span: Float64[np.ndarray, "times 3"], length: float, airborne: Float64[np.ndarray, " times"]
) -> tuple[Float64[np.ndarray, " times"], Float64[np.ndarray, "times 3"]]:
    """Distance and direction hip → ankle; the distance is exact for planted feet and saturates for feet in the air."""
    distance = np.linalg.norm(span, axis=-1)
    free = (PLANTED_STRETCH - SWING_FLEXION * airborne) * length
    margin = (STRETCH_MARGIN + 0.8 * SWING_FLEXION * airborne) * length
    reach = np.minimum(distance, free) + margin * np.tanh(np.maximum(distance - free, 0.0) / margin)
    return np.maximum(reach, 0.2 * length), span / distance[:, None]


def _frame(x: Float64[np.ndarray, "times 3"], y: Float64[np.ndarray, "times 3"]) -> Float64[np.ndarray, "times 3 3"]:
    """Rotation matrices whose first two columns are the given orthonormal vectors."""
    return np.stack((x, y, np.cross(x, y)), axis=-1)
