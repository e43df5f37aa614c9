"""A source's unit and up axis: given by the user, or inferred from the body; and motions in metres, y up."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float, Float32
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, body_axis, family_unit_metres, joint_map, rest_positions

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "1/0.45 inch": 0.0254 / 0.45}
# From the ankles through the hips to the base of the skull: 1.45 m in SMPL's mean body.
TYPICAL_HEIGHT_METRES = 1.45
# For a skeleton with unknown names, the longest chain from the root to a fingertip or a toe.
TYPICAL_CHAIN_METRES = 1.25
PLAUSIBLE_FACTOR = 2.2
# Characters may be giants, if somebody says so; units differ by 10 and more.
GIVEN_UNIT_FACTOR = 5.0
_CHAINS = ("left_ankle left_knee left_hip", "pelvis spine1 spine2 spine3 neck head")
TRUNK_AND_LEGS = tuple(bone for chain in _CHAINS for bone in pairwise(chain.split()))


@lru_cache(maxsize=64)  # the takes of a corpus share their skeletons
def infer_unit(skeleton: Skeleton) -> tuple[float, str] | None:
    """Metres per unit of a skeleton in file units, and the reason; None if no unit gives a human body.

    A family with its own unit (the CMU database: 0.0254 / 0.45 m; MakeHuman: a decimetre) gets it if the body is then
    plausible. Otherwise it is the one among m, cm, mm, inch and the CMU database's that brings the rest skeleton's
    standing height (ankles to head along the bones) nearest to 1.45 m; for unknown joint names, the longest chain
    nearest to 1.25 m.
    """
    size, typical, what = _size(skeleton)
    own = family_unit_metres(skeleton)
    if own is not None and _factor(size * own, typical) <= 1.5:
        return (own, f"the unit of the family whose joint names they are; {what} is {size * own:.2f} m")
    if size <= 0:
        return None
    name, metres = min(UNITS.items(), key=lambda unit: _factor(size * unit[1], typical))
    if _factor(size * metres, typical) > PLAUSIBLE_FACTOR:
        return None
    return (metres, f"inferred: in {name} {what} is {size * metres:.2f} m")


def standing_metres(skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"]) -> float:
    """Median length from the ankles along the bones to the head; raises `SkeletonMapError` for unknown joints."""
    body = np.matmul(joint_map(skeleton, SMPL22.name).weights, joint_positions)
    return float(np.median(bone_lengths(body).sum(axis=-1)))


def check_unit(
    skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"], unit_metres: float | None, path: Path
) -> None:
    """Raise `FormatError` (`unit`) if a given unit makes a body 5 times larger or smaller than a person."""
    if unit_metres is None:
        return
    try:
        metres = standing_metres(skeleton, joint_positions)
    except SkeletonMapError:
        return
    if metres > 0 and _factor(metres, TYPICAL_HEIGHT_METRES) > GIVEN_UNIT_FACTOR:
        usual = unit_metres * TYPICAL_HEIGHT_METRES / metres
        message = f"a unit of {unit_metres:g} m makes a body of {metres:.3g} m from ankles to head"
        raise FormatError(f"{message}: expected a unit of about {usual:.2g} m", path=path, reason="unit")


def is_plausible(metres: float) -> bool:
    """Whether this is a plausible length from ankle to head."""
    return _factor(metres, TYPICAL_HEIGHT_METRES) <= PLAUSIBLE_FACTOR


def logged_unit(operations: Sequence[str]) -> tuple[float, str]:
    """Metres per unit of a source by its motion's operation log, and its reason; 1 where nothing was scaled."""
    match = next(filter(None, (re.match(r"lengths × (\S+) to metres \((.+)\)", line) for line in operations)), None)
    return (1.0, "metres") if match is None else (float(match[1]), match[2])


def bone_lengths(joints: Float[np.ndarray, "*poses 22 3"]) -> Float[np.ndarray, "*poses bones"]:
    """Lengths of the bones from the ankles to the head; their sum is 1.45 m for an average person."""
    first, second = np.array([(SMPL22.index(a), SMPL22.index(b)) for a, b in TRUNK_AND_LEGS]).T
    return np.asarray(np.linalg.norm(joints[..., first, :] - joints[..., second, :], axis=-1))


def _factor(size: float, typical: float) -> float:
    return max(size / typical, typical / size) if size > 0 else np.inf


def _size(skeleton: Skeleton) -> tuple[float, float, str]:
    try:
        weights = joint_map(skeleton, SMPL22.name).weights
    except SkeletonMapError:
        return _longest_chain(skeleton), TYPICAL_CHAIN_METRES, "the longest chain"
    rest = weights @ rest_positions(skeleton)
    return float(bone_lengths(rest).sum()), TYPICAL_HEIGHT_METRES, "ankle to head"


def _longest_chain(skeleton: Skeleton) -> float:
    reach = np.zeros(skeleton.num_joints)
    lengths = np.linalg.norm(skeleton.offsets, axis=-1)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            reach[joint] = reach[parent] + lengths[joint]
    return float(reach.max())


def in_metres(motion: Motion, unit_metres: float | None) -> Motion:
    """Scale all lengths of a motion and its skeleton by `unit_metres`, and log it; None or 1 changes nothing.

    A standard skeleton, used if the file describes none, is in metres already.
    """
    if unit_metres is None or unit_metres == 1.0:
        return motion
    factor = np.float32(unit_metres)
    standard = motion.skeleton in STANDARD_SKELETONS.values()
    scaled = replace(
        motion,
        joint_positions=motion.joint_positions * factor,
        root_translation=None if motion.root_translation is None else motion.root_translation * factor,
        skeleton=motion.skeleton if standard else motion.skeleton.scaled(unit_metres),
    )
    return scaled.logged(f"lengths × {unit_metres:g} to metres (given)")


_HALF = np.sqrt(0.5)
# Up axis → the rotation (det +1) that takes it to +y, as order and signs of the coordinates and as a quaternion. Left
# and right are kept.
_TURNS = {
    "x": ((1, 0, 2), (-1, 1, 1), (_HALF, 0, 0, _HALF)),
    "-x": ((1, 0, 2), (1, -1, 1), (_HALF, 0, 0, -_HALF)),
    "y": ((0, 1, 2), (1, 1, 1), (1, 0, 0, 0)),
    "-y": ((0, 1, 2), (1, -1, -1), (0, 1, 0, 0)),
    "z": ((0, 2, 1), (1, 1, -1), (_HALF, -_HALF, 0, 0)),
    "-z": ((0, 2, 1), (1, -1, 1), (_HALF, _HALF, 0, 0)),
}
AXES = tuple(_TURNS)
# The axes that a user may give.
GIVEN_AXES = ("x", "y", "z")

# The frames that an inference looks at, evenly spaced.
SAMPLED_FRAMES = 128
# A body is along an axis if the mean vector from feet to head is longer along it than along the other one by this
# factor, and has this share of the mean distance from feet to head.
ALONG, ALONG_SHARE = 2.0, 0.5
# Heights of the lowest joint's centre over the floor at 0, in metres, for 90 % of the frames: of a lying body, on
# anything up to a bed, and of feet. A body that lies stays on what bears it; feet leave the floor.
LYING_METRES, LYING_RANGE_METRES = (-0.05, 1.0), 0.2
STANDING_METRES = (-0.15, 0.3)


def to_y_up(vectors: Float[np.ndarray, "*shape 3"], up: str) -> Float[np.ndarray, "*shape 3"]:
    """Rotate vectors so that the axis `up` becomes +y."""
    order, signs, _ = _TURNS[up]
    return np.asarray(vectors[..., order] * np.array(signs, vectors.dtype))


def from_y_up(vectors: Float[np.ndarray, "*shape 3"], up: str) -> Float[np.ndarray, "*shape 3"]:
    """The inverse of `to_y_up`."""
    order, signs, _ = _TURNS[up]
    back = np.argsort(order)
    return np.asarray(vectors[..., back] * np.array(signs, vectors.dtype)[back])


def turn_of(up: str) -> Float32[np.ndarray, "4"]:
    """The rotation of `to_y_up` as a quaternion."""
    return np.array(_TURNS[up][2], np.float32)


def skeleton_to_y_up(skeleton: Skeleton, up: str) -> Skeleton:
    """A rest pose with the axis `up` turned to +y."""
    tips = ((joint, to_y_up(np.array(tip), up).tolist()) for joint, tip in skeleton.end_sites)
    return replace(
        skeleton,
        offsets=to_y_up(skeleton.offsets, up),
        end_sites=tuple((joint, (x, y, z)) for joint, (x, y, z) in tips),
    )


def turned(motion: Motion, up: str) -> Motion:
    """The motion with the axis `up` turned to +y: positions, the root's rotation and translation; not the rest pose."""
    if up == "y":
        return motion
    rotations, root = motion.local_rotations, motion.root_translation
    if rotations is not None:
        rotations = rotations.copy()
        rotations[:, 0] = kinematics.quaternion_multiply(turn_of(up), rotations[:, 0])
    return replace(
        motion,
        joint_positions=to_y_up(motion.joint_positions, up),
        local_rotations=rotations,
        root_translation=None if root is None else to_y_up(root, up),
    )


def log_lines(up: str, given: str = "") -> list[str]:
    """The line of the operation log for a source's up axis; none for an inferred y."""
    axis, end = up.removeprefix("-"), "down" if up.startswith("-") else "up"
    line = "y up" if up == "y" else f"turned from {axis} {end} to y up"
    return [f"{line} (given)"] if given else [line] if up != "y" else []


def logged_up(operations: Sequence[str]) -> str:
    """The up axis of a source by its motion's operation log."""
    match = next(filter(None, (re.match(r"turned from (−?[xyz]) (up|down)", line) for line in operations)), None)
    if match is None:
        return "y"
    return f"-{match[1]}" if match[2] == "down" else match[1].replace("−", "-")


def upright(
    skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"], given: str = ""
) -> tuple[Float32[np.ndarray, "frames joints 3"], list[str]]:
    """Positions turned to y up from the axis `given`, else from y, z or −y as inferred; and the log's line."""
    up = given or infer_up(skeleton, joint_positions, ("y", "z", "-y"))
    return (joint_positions if up == "y" else to_y_up(joint_positions, up)), log_lines(up, given)


def infer_up(skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"], axes: Sequence[str]) -> str:
    """The one of `axes` (y, z, −y) that points up in a motion; the first is the expected one, also for unknown joints.

    On average over a motion people's heads are above their feet, so another axis points up if the body is along it.
    A body that lies for the whole motion is along another axis too: the expected one then stays if the lowest joint
    keeps to one height over the floor along it, and feet do not keep to a floor along the other one.
    """
    expected, *others = axes
    number = min(len(joint_positions), SAMPLED_FRAMES)
    positions = joint_positions[np.linspace(0, len(joint_positions) - 1, number).astype(np.int64)]
    try:
        vectors = body_axis(skeleton, positions)
    except SkeletonMapError:
        return expected
    _, y, z = vectors.mean(axis=0).tolist()
    least = ALONG_SHARE * float(np.linalg.norm(vectors, axis=-1).mean())
    across = {"y": abs(z), "-y": abs(z), "z": abs(y)}
    for other in others:
        length = {"y": y, "-y": -y, "z": z}[other]
        if length > max(least, ALONG * across[other]) and not (other != "-y" and _lies(positions, expected, other)):
            return other
    return expected


def _lies(positions: Float32[np.ndarray, "frames joints 3"], expected: str, other: str) -> bool:
    low, high = _lowest(positions, expected)
    lies = LYING_METRES[0] <= low and high <= LYING_METRES[1] and high - low <= LYING_RANGE_METRES
    low, high = _lowest(positions, other)
    return bool(lies and not (STANDING_METRES[0] <= low and high <= STANDING_METRES[1]))


def _lowest(positions: Float32[np.ndarray, "frames joints 3"], up: str) -> tuple[float, float]:
    """The 5 % and 95 % quantiles over the frames of the lowest joint's coordinate along an axis."""
    low, high = np.quantile(to_y_up(positions, up)[..., 1].min(axis=1), (0.05, 0.95)).tolist()
    return low, high
