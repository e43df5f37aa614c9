"""Retargeting: world rotations transferred between rest poses, the path scaled by leg length.

A joint of the target has its counterpart's world rotation relative to the rest pose. Between two standing rest poses,
the trunk, feet and hands are assumed equal, and upper arms, forearms, thighs and shanks are aligned by rotation, so
that an A-pose can follow a T-pose. The target's bones keep their lengths.
"""

from dataclasses import replace
from fractions import Fraction

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import canonical_names, counterpart_joints, map_joints, rest_positions
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.contact.bones import Legs, legs_of
from motionkit.io.joint_rotations import joint_channels
from motionkit.io.smpl_body import mean_shape_skeleton

Quaternion = Float64[np.ndarray, "4"]
Quaternions = Float64[np.ndarray, "frames joints 4"]
Rest22 = Float32[np.ndarray, "22 3"]

LIMBS = {"shoulder": "elbow", "elbow": "wrist", "hip": "knee", "knee": "ankle"}
# The largest angle between a standing body's bone at rest and that of SMPL's T-pose; arms may hang.
MAX_DEGREES = {"shoulder": 60.0, "hip": 80.0, "elbow": 110.0, "wrist": 110.0, "foot": 50.0, "head": 70.0}
OTHER_MAX_DEGREES = 45.0
# Of the lowest points of feet over all frames, the quantile that stands on the floor.
LOW_QUANTILE = 0.05


def retarget(motion: Motion, target: Skeleton, rest: Float64[np.ndarray, "joints 4"] | None = None) -> Motion:
    """The motion on another skeleton with a known map to the 22-joint layout, at the same instants, y up, metres.

    `rest` are the target's local rotations in a standing pose, needed if its rest pose is not one. If the source has
    no rotations, or no standing rest pose, rotations come from inverse kinematics on SMPL's 22 joints, without twist
    of the limbs and without hands. Raises `SkeletonMapError`, and `MotionkitError` for a target without a standing
    pose.
    """
    standing = target if rest is None else standing_skeleton(target, rest)
    if not stands(standing):
        raise MotionkitError(f"the rest pose of {target.name} does not stand, as a T-pose does")
    source, how = motion, ""
    if motion.local_rotations is None or not stands(motion.skeleton):
        source, how = _with_rotations(motion), ", rotations by inverse kinematics on SMPL's 22 joints"
    world = _world_rotations(source, standing)
    local = _local_rotations(world, standing)
    scale, path = _path(source, local, standing)
    if rest is not None:
        world = kinematics.quaternion_multiply(world, kinematics.global_rotations(rest[None], target))
        local = _local_rotations(world, target)
    positions = kinematics.forward_kinematics(local, path, target)
    retargeted = Motion(
        positions.astype(np.float32), target, motion.timegrid, local.astype(np.float32), path.astype(np.float32)
    )
    line = f"onto the skeleton {target.name}: legs and path × {scale:.3f}{how}"
    return retargeted.annotated_like(motion).logged(line)


def standing_skeleton(skeleton: Skeleton, rest: Float64[np.ndarray, "joints 4"]) -> Skeleton:
    """The skeleton whose rest pose is the pose of `skeleton` under these local rotations."""
    world = kinematics.global_rotations(rest[None], skeleton)[0]
    offsets = kinematics.quaternion_rotate(world[skeleton.parents_or_self], skeleton.offsets.astype(np.float64))
    offsets[0] = skeleton.offsets[0]
    tips = tuple(
        (joint, tuple(kinematics.quaternion_rotate(world[joint], np.array(tip)).tolist()))
        for joint, tip in skeleton.end_sites
    )
    return replace(skeleton, offsets=offsets.astype(np.float32), end_sites=tips)


def stands(skeleton: Skeleton) -> bool:
    """Whether a skeleton's rest pose is a standing one, with arms anywhere between horizontal and hanging."""
    rest, expected = _rest22(skeleton), rest_positions(mean_shape_skeleton())
    facing = _facing(expected, rest)
    for joint, parent in enumerate(SMPL22.parents):
        if parent < 0:
            continue
        bone = rest[joint] - rest[parent]
        usual = kinematics.quaternion_rotate(facing, (expected[joint] - expected[parent]).astype(np.float64))
        cosine = float(bone @ usual) / max(float(np.linalg.norm(bone) * np.linalg.norm(usual)), 1e-9)
        degrees = MAX_DEGREES.get(SMPL22.joint_names[joint].rpartition("_")[2], OTHER_MAX_DEGREES)
        if np.linalg.norm(bone) > 0.02 and cosine < np.cos(np.radians(degrees)):
            return False
    return True


def _rest22(skeleton: Skeleton) -> Rest22:
    identity = np.zeros((1, skeleton.num_joints, 4), np.float32)
    identity[..., 0] = 1.0
    pose = Motion(rest_positions(skeleton)[None], skeleton, TimeGrid(Fraction(1), 1), identity)
    return np.asarray(map_joints(pose, SMPL22.name)[0])


def _with_rotations(motion: Motion) -> Motion:
    """The motion's 22 joints with rotations relative to SMPL's rest pose, on bones of its own lengths."""
    positions = map_joints(motion, SMPL22.name).astype(np.float32)
    fitted = joint_channels(Motion(positions, mean_shape_skeleton(), motion.timegrid))
    return Motion(positions, fitted.skeleton, motion.timegrid, fitted.rotations, positions[:, 0])


def _facing(target: Rest22, source: Rest22) -> Quaternion:
    """The rotation of a target's trunk at rest to the source's."""

    def trunk(rest: Rest22) -> Float64[np.ndarray, "1 3 3"]:
        at = {name: rest[joint].astype(np.float64) for joint, name in enumerate(SMPL22.joint_names)}
        spine = at["neck"] - (at["left_hip"] + at["right_hip"]) / 2
        bones = np.stack((at["left_hip"] - at["right_hip"], at["left_shoulder"] - at["right_shoulder"], spine))
        return np.asarray(bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-9))[None]

    return np.asarray(kinematics.fit_rotation(trunk(target), trunk(source))[0])


def _world_rotations(source: Motion, target: Skeleton) -> Quaternions:
    """The target's world rotations relative to its rest pose; joints without a counterpart follow their parents."""
    assert source.local_rotations is not None
    rotations = kinematics.global_rotations(source.local_rotations.astype(np.float64), source.skeleton)
    world = np.zeros((source.num_frames, target.num_joints, 4))
    world[..., 0] = 1.0
    alignments = _alignments(source.skeleton, target)
    for joint, parent in enumerate(target.parents):
        if joint in alignments:
            counterpart, alignment = alignments[joint]
            world[:, joint] = kinematics.quaternion_multiply(rotations[:, counterpart], alignment)
        elif parent >= 0:
            world[:, joint] = world[:, parent]
    world /= np.linalg.norm(world, axis=-1, keepdims=True)
    return world


def _local_rotations(world: Quaternions, skeleton: Skeleton) -> Quaternions:
    local, parents = world.copy(), list(skeleton.parents[1:])
    local[:, 1:] = kinematics.quaternion_multiply(kinematics.quaternion_conjugate(world[:, parents]), world[:, 1:])
    return local


def _alignments(source: Skeleton, target: Skeleton) -> dict[int, tuple[int, Quaternion]]:
    """Target joint → its counterpart, and the rotation from the target's rest pose to the source's."""
    facing = _facing(_rest22(target), _rest22(source))
    target_rest, source_rest = rest_positions(target), rest_positions(source)
    target_joints, source_joints = (
        {SMPL22.joint_names[joint]: own for joint, own in counterpart_joints(each).items()} for each in (target, source)
    )
    shared = [name for name in SMPL22.joint_names if name in target_joints and name in source_joints]
    turns: dict[str, Quaternion] = {}
    for name in shared:
        side, _, limb = name.rpartition("_")
        end = f"{side}_{LIMBS.get(limb, '')}"
        turns[name] = facing
        if end in shared:
            bone = target_rest[target_joints[end]] - target_rest[target_joints[name]]
            source_bone = source_rest[source_joints[end]] - source_rest[source_joints[name]]
            bone = kinematics.quaternion_rotate(facing, bone.astype(np.float64))
            onto = kinematics.quaternion_between(bone, source_bone.astype(np.float64))
            turns[name] = kinematics.quaternion_multiply(onto, facing)
        elif limb == "wrist" and f"{side}_elbow" in turns:
            turns[name] = turns[f"{side}_elbow"]
    alignments = {target_joints[name]: (source_joints[name], turns[name]) for name in shared}
    # Fingers and other joints with the same name in both have their parent's alignment.
    named = {name: joint for joint, name in enumerate(canonical_names(source.joint_names))}
    used = {counterpart for counterpart, _ in alignments.values()}
    for joint, name in enumerate(canonical_names(target.joint_names)):
        parent = target.parents[joint]
        if joint not in alignments and parent in alignments and name in named and named[name] not in used:
            alignments[joint] = (named[name], alignments[parent][1])
    return alignments


def _path(source: Motion, local: Quaternions, target: Skeleton) -> tuple[float, Float64[np.ndarray, "frames 3"]]:
    """The ratio of leg lengths, target to source, and the root's path, with hip heights scaled by it."""
    legs, source_legs = legs_of(target), legs_of(source.skeleton)
    scale = _leg_length(target, legs) / max(_leg_length(source.skeleton, source_legs), 1e-6)
    at_origin = kinematics.forward_kinematics(local, np.zeros((len(local), 3)), target)
    positions = source.joint_positions.astype(np.float64)
    path = scale * _hips(positions, source_legs) - _hips(at_origin, legs)
    low = np.quantile(legs.foot_paths(at_origin + path[:, None])[..., 1].min(axis=(1, 2)), LOW_QUANTILE)
    source_low = np.quantile(source_legs.foot_paths(positions)[..., 1].min(axis=(1, 2)), LOW_QUANTILE)
    path[:, 1] += scale * (source_low - _sole(source.skeleton, source_legs)) - (low - _sole(target, legs))
    return scale, path


def _hips(positions: Float64[np.ndarray, "frames joints 3"], legs: Legs) -> Float64[np.ndarray, "frames 3"]:
    return np.asarray((positions[:, legs.left.hip] + positions[:, legs.right.hip]) / 2)


def _leg_length(skeleton: Skeleton, legs: Legs) -> float:
    """Mean length of both legs at rest, hip to ankle along the bones, metres."""
    rest = rest_positions(skeleton)
    bones = [bone for leg in (legs.left, legs.right) for bone in ((leg.hip, leg.knee), (leg.knee, leg.ankle))]
    return float(sum(np.linalg.norm(rest[start] - rest[end]) for start, end in bones) / 2)


def _sole(skeleton: Skeleton, legs: Legs) -> float:
    """Height of the lowest of ankles and toes above the lowest point of the feet at rest, metres."""
    heights = rest_positions(skeleton)[:, 1]
    joints = {joint for leg in (legs.left, legs.right) for joint in (leg.ankle, *leg.foot)}
    points = [heights[joint] for joint in joints]
    points += [heights[joint] + tip[1] for joint, tip in skeleton.end_sites if joint in joints]
    return float(min(heights[joint] for joint in legs.feet) - min(points))
