"""Retargeting: world rotations transferred between rest poses, the path scaled by leg length.

A joint of the target has its counterpart's world rotation relative to the rest pose. Between two standing rest poses,
the trunk, feet and hands are assumed equal, and upper arms, forearms, thighs and shanks are aligned by rotation, so
that an A-pose can follow a T-pose. The target's bones keep their lengths.
"""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.families import canonical_names
from motionkit.core.skeletons.mapping import map_joints, rest_positions
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.contact.legs import Legs, legs_of
from motionkit.fields.transfer import counterpart_joints
from motionkit.io.joint_rotations import joint_channels
from motionkit.io.smpl_body import mean_shape_skeleton

_LIMBS = {"shoulder": "elbow", "elbow": "wrist", "hip": "knee", "knee": "ankle"}
# Limits on a standing body's bones at rest, relative to SMPL's T-pose; arms may hang.
_MOST_DEGREES = {"shoulder": 60.0, "hip": 80.0, "elbow": 110.0, "wrist": 110.0, "foot": 50.0, "head": 70.0}
_MOST_OTHERS_DEGREES = 45.0
_LOW = 0.05

Quaternion = Float64[np.ndarray, "4"]


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
    source = motion if motion.local_rotations is not None and stands(motion.skeleton) else _fitted(motion)
    local, turns = _rotations(source, standing)
    share, path = _path(source, local, standing)
    if rest is not None:
        local = _from_rest(turns, rest, target)
    positions = kinematics.forward_kinematics(local, path, target)
    found = "" if source is motion else ", rotations by inverse kinematics on SMPL's 22 joints"
    return (
        Motion(
            positions.astype(np.float32),
            target,
            motion.timegrid,
            local.astype(np.float32),
            path.astype(np.float32),
        )
        .annotated_like(motion)
        .logged(f"onto the skeleton {target.name}: legs and path × {share:.3f}{found}")
    )


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


def _rotations(
    source: Motion, target: Skeleton
) -> tuple[Float64[np.ndarray, "frames joints 4"], Float64[np.ndarray, "frames joints 4"]]:
    """The target's local and world rotations."""
    assert source.local_rotations is not None
    turned = kinematics.global_rotations(source.local_rotations.astype(np.float64), source.skeleton)
    world = np.zeros((source.num_frames, target.num_joints, 4))
    world[..., 0] = 1.0
    pairs = _pairs(source.skeleton, target)
    for joint, parent in enumerate(target.parents):
        if joint in pairs:
            counterpart, alignment = pairs[joint]
            world[:, joint] = kinematics.quaternion_multiply(turned[:, counterpart], alignment)
        elif parent >= 0:
            world[:, joint] = world[:, parent]
    world /= np.linalg.norm(world, axis=-1, keepdims=True)
    return _local(world, target), world


def _local(world: Float64[np.ndarray, "frames joints 4"], skeleton: Skeleton) -> Float64[np.ndarray, "frames joints 4"]:
    local, parents = world.copy(), list(skeleton.parents[1:])
    local[:, 1:] = kinematics.quaternion_multiply(kinematics.quaternion_conjugate(world[:, parents]), world[:, 1:])
    return local


def _from_rest(
    turns: Float64[np.ndarray, "frames joints 4"], rest: Float64[np.ndarray, "joints 4"], target: Skeleton
) -> Float64[np.ndarray, "frames joints 4"]:
    """Local rotations of a target with rotations at rest, from its world rotations relative to them."""
    return _local(kinematics.quaternion_multiply(turns, kinematics.global_rotations(rest[None], target)), target)


def stands(skeleton: Skeleton) -> bool:
    """Whether a skeleton's rest pose is a standing one, with arms anywhere between horizontal and hanging."""
    rest, usual = _rest22(skeleton), rest_positions(mean_shape_skeleton())
    turn = _facing(usual, rest)
    for joint, parent in enumerate(SMPL22.parents):
        if parent < 0:
            continue
        bone = rest[joint] - rest[parent]
        expected = kinematics.quaternion_rotate(turn, (usual[joint] - usual[parent]).astype(np.float64))
        size = np.linalg.norm(bone) * np.linalg.norm(expected)
        cosine = float(bone @ expected) / max(float(size), 1e-9)
        most = _MOST_DEGREES.get(SMPL22.joint_names[joint].rpartition("_")[2], _MOST_OTHERS_DEGREES)
        if np.linalg.norm(bone) > 0.02 and cosine < np.cos(np.radians(most)):
            return False
    return True


def _rest22(skeleton: Skeleton) -> Float32[np.ndarray, "22 3"]:
    unturned = np.zeros((1, skeleton.num_joints, 4), np.float32)
    unturned[..., 0] = 1.0
    pose = Motion(rest_positions(skeleton)[None], skeleton, TimeGrid(Fraction(1), 1), unturned)
    joints: Float32[np.ndarray, "22 3"] = map_joints(pose, SMPL22.name)[0]
    return joints


def _fitted(motion: Motion) -> Motion:
    """The motion's 22 joints with rotations relative to SMPL's rest pose, on bones of its own lengths."""
    positions = map_joints(motion, SMPL22.name).astype(np.float32)
    made = joint_channels(Motion(positions, mean_shape_skeleton(), motion.timegrid))
    return Motion(positions, made.skeleton, motion.timegrid, made.rotations, positions[:, 0])


def _facing(target: Float32[np.ndarray, "22 3"], source: Float32[np.ndarray, "22 3"]) -> Quaternion:
    """The rotation of a target's trunk at rest to the source's."""

    def trunk(rest: Float32[np.ndarray, "22 3"]) -> Float64[np.ndarray, "1 bones 3"]:
        place = {name: rest[joint].astype(np.float64) for joint, name in enumerate(SMPL22.joint_names)}
        middle = (place["left_hip"] + place["right_hip"]) / 2
        bones = np.stack(
            (
                place["left_hip"] - place["right_hip"],
                place["left_shoulder"] - place["right_shoulder"],
                place["neck"] - middle,
            )
        )
        return np.asarray(bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-9))[None]

    return np.asarray(kinematics.fit_rotation(trunk(target), trunk(source))[0])


@dataclass(frozen=True, eq=False)
class _Rig:
    """A skeleton at rest, and its joints by the layout's names."""

    rest: Float32[np.ndarray, "joints 3"]
    own: dict[str, int]

    @classmethod
    def of(cls, skeleton: Skeleton) -> "_Rig":
        own = {SMPL22.joint_names[joint]: source for joint, source in counterpart_joints(skeleton).items()}
        return cls(rest_positions(skeleton), own)

    def bone(self, name: str, below: str) -> Float64[np.ndarray, "3"]:
        return np.asarray(self.rest[self.own[below]] - self.rest[self.own[name]], np.float64)


def _pairs(source: Skeleton, target: Skeleton) -> dict[int, tuple[int, Quaternion]]:
    """Target joint → its counterpart, and the rotation from the target's rest pose to the source's."""
    facing = _facing(_rest22(target), _rest22(source))
    mine, theirs = _Rig.of(target), _Rig.of(source)
    shared = [name for name in SMPL22.joint_names if name in mine.own and name in theirs.own]
    turns: dict[str, Quaternion] = {}
    for name in shared:
        side, _, joint = name.rpartition("_")
        below, above = f"{side}_{_LIMBS.get(joint, '')}", f"{side}_elbow"
        turns[name] = facing
        if below in shared:
            bone = kinematics.quaternion_rotate(facing, mine.bone(name, below))
            onto = kinematics.quaternion_between(bone, theirs.bone(name, below))
            turns[name] = kinematics.quaternion_multiply(onto, facing)
        elif joint == "wrist" and above in turns:
            turns[name] = turns[above]
    pairs = {mine.own[name]: (theirs.own[name], turns[name]) for name in shared}
    # Fingers and other joints with the same name in both take their parent's alignment.
    named = {called: place for place, called in enumerate(canonical_names(source.joint_names))}
    used = {counterpart for counterpart, _ in pairs.values()}
    for own, called in enumerate(canonical_names(target.joint_names)):
        parent = target.parents[own]
        if own not in pairs and parent in pairs and named.get(called, -1) not in used | {-1}:
            pairs[own] = (named[called], pairs[parent][1])
    return pairs


def _path(
    source: Motion, local: Float64[np.ndarray, "frames joints 4"], target: Skeleton
) -> tuple[float, Float64[np.ndarray, "frames 3"]]:
    """The ratio of leg lengths, target to source, and the root's path, with hip heights scaled by it."""
    mine, theirs = legs_of(target), legs_of(source.skeleton)
    share = _leg_length(target, mine) / max(_leg_length(source.skeleton, theirs), 1e-6)
    at_origin = kinematics.forward_kinematics(local, np.zeros((len(local), 3)), target)
    wanted = source.joint_positions.astype(np.float64)
    path = share * _hips(wanted, theirs) - _hips(at_origin, mine)
    lowest = np.quantile(mine.foot_paths(at_origin + path[:, None])[..., 1].min(axis=(1, 2)), _LOW)
    before = np.quantile(theirs.foot_paths(wanted)[..., 1].min(axis=(1, 2)), _LOW)
    path[:, 1] += share * (before - _sole(source.skeleton, theirs)) - (lowest - _sole(target, mine))
    return share, path


def _hips(positions: Float64[np.ndarray, "frames joints 3"], legs: Legs) -> Float64[np.ndarray, "frames 3"]:
    middle: Float64[np.ndarray, "frames 3"] = (positions[:, legs.left.hip] + positions[:, legs.right.hip]) / 2
    return middle


def _leg_length(skeleton: Skeleton, legs: Legs) -> float:
    rest = rest_positions(skeleton)
    bones = [(leg.hip, leg.knee) for leg in (legs.left, legs.right)]
    bones += [(leg.knee, leg.ankle) for leg in (legs.left, legs.right)]
    return float(sum(np.linalg.norm(rest[start] - rest[end]) for start, end in bones) / 2)


def _sole(skeleton: Skeleton, legs: Legs) -> float:
    """Height of the lowest of ankles and toes above the lowest point of the feet at rest, metres."""
    rest = rest_positions(skeleton)[:, 1]
    below = {joint for leg in (legs.left, legs.right) for joint in (leg.ankle, *leg.foot)}
    points = [rest[joint] for joint in below]
    points += [rest[joint] + offset[1] for joint, offset in skeleton.end_sites if joint in below]
    return float(min(rest[joint] for joint in legs.feet) - min(points))
