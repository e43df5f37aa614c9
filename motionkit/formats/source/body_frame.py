"""Inference of a source's unit and up axis from the size and pose of the body; lengths in metres."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Float64

from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, family_unit_metres, joint_map, rest_positions

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "1/0.45 inch": 0.0254 / 0.45}
# From the ankles through the hips to the base of the skull: 1.45 m in SMPL's mean body.
TYPICAL_HEIGHT_METRES = 1.45
# For a skeleton with unknown names, the longest chain from the root to a fingertip or a toe.
TYPICAL_CHAIN_METRES = 1.25
PLAUSIBLE_FACTOR = 2.2
TRUNK_AND_LEGS = (
    ("left_ankle", "left_knee"),
    ("left_knee", "left_hip"),
    ("pelvis", "spine1"),
    ("spine1", "spine2"),
    ("spine2", "spine3"),
    ("spine3", "neck"),
    ("neck", "head"),
)


@dataclass(frozen=True)
class Unit:
    """Metres per file unit and how it was found."""

    metres: float
    reason: str


@lru_cache(maxsize=64)  # the takes of a corpus share their skeletons
def infer_unit(skeleton: Skeleton) -> Unit | None:
    """The unit of a skeleton whose offsets are in file units; None if no unit gives a human body.

    A family with its own unit (the CMU database: 0.0254 / 0.45 m; MakeHuman: a decimetre) gets it if the body is then
    plausible. Otherwise it is the one among m, cm, mm, inch and the CMU database's that brings the rest skeleton's
    standing height (ankles to head along the bones) nearest to 1.45 m; for unknown joint names, the longest chain
    nearest to 1.25 m.
    """
    size, typical, what = _size(skeleton)
    own = family_unit_metres(skeleton)
    if own is not None and _factor(size * own, typical) <= 1.5:
        return Unit(own, f"the unit of the family whose joint names they are; {what} is {size * own:.2f} m")
    if size <= 0:
        return None
    name, metres = min(UNITS.items(), key=lambda unit: _factor(size * unit[1], typical))
    if _factor(size * metres, typical) > PLAUSIBLE_FACTOR:
        return None
    return Unit(metres, f"inferred: in {name} {what} is {size * metres:.2f} m")


def rests_along_z(skeleton: Skeleton) -> bool:
    """Whether the rest pose of a skeleton with known joints stands along +z rather than +y."""
    try:
        _, y, z = _upward(skeleton) @ rest_positions(skeleton)
    except SkeletonMapError:
        return False
    return bool(z > 2.0 * abs(y))


def stands_along_z(skeleton: Skeleton, mean_positions: Float32[np.ndarray, "joints 3"]) -> bool:
    """Whether a body, its joints averaged over time, stands along +z; raises `SkeletonMapError` for unknown joints."""
    _, y, z = _upward(skeleton) @ mean_positions
    return bool(z > abs(y))


def _upward(skeleton: Skeleton) -> Float32[np.ndarray, " joints"]:
    # Weights of the joints whose sum is the vector from the ankles to the head.
    weights = joint_map(skeleton, SMPL22.name).weights
    ankles = weights[SMPL22.index("left_ankle")] + weights[SMPL22.index("right_ankle")]
    upward: Float32[np.ndarray, " joints"] = weights[SMPL22.index("head")] - np.float32(0.5) * ankles
    return upward


# The rotations about x, by 180° and 90°, that take −y and z to y.
TURNS = {
    "-y": np.array([0.0, 1.0, 0.0, 0.0], np.float32),
    "z": np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0], np.float32),
    "y": np.array([1.0, 0.0, 0.0, 0.0], np.float32),
}
TURNED = {
    "-y": ["turned from y down to y up: (x, y, z) → (x, −y, −z)"],
    "z": ["turned from z up to y up: (x, y, z) → (x, z, −y)"],
    "y": [],
}


def upright_turn(
    skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"]
) -> tuple[Float32[np.ndarray, "4"], list[str]]:
    """The rotation that `upright` applies, as a quaternion, and its log line."""
    axis = _axis_of(skeleton, joint_positions)
    return TURNS[axis], TURNED[axis]


def _axis_of(skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"]) -> str:
    head, left, right = (_joint(skeleton, joint_positions, name) for name in ("head", "left_ankle", "right_ankle"))
    _, y, z = (head - 0.5 * (left + right)).mean(axis=0).tolist()
    if z > 2.0 * abs(y):
        return "z"
    return "-y" if -y > 2.0 * abs(z) else "y"


def upright(
    skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"]
) -> tuple[Float32[np.ndarray, "frames joints 3"], list[str]]:
    """Positions of a standard layout rotated so that the body on average stands along +y; a log line if it did not.

    Rotations are about x, so left and right are kept: from z up, (x, y, z) → (x, z, −y); from y down, (x, −y, −z).
    """
    axis = _axis_of(skeleton, joint_positions)
    if axis == "z":
        joint_positions = turn_to_y_up(joint_positions)
    elif axis == "-y":
        joint_positions = joint_positions * np.array([1, -1, -1], np.float32)
    return joint_positions, list(TURNED[axis])


def _joint(
    skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"], name: str
) -> Float32[np.ndarray, "frames 3"]:
    weights = joint_map(skeleton, SMPL22.name).weights[SMPL22.index(name)]
    place: Float32[np.ndarray, "frames 3"] = np.matmul(weights, joint_positions)
    return place


def z_up_to_y_up(
    skeleton: Skeleton,
    joint_positions: Float32[np.ndarray, "frames joints 3"],
    local_rotations: Float32[np.ndarray, "frames joints 4"],
    root_translation: Float32[np.ndarray, "frames 3"],
) -> tuple[
    Skeleton,
    Float32[np.ndarray, "frames joints 3"],
    Float32[np.ndarray, "frames joints 4"],
    Float32[np.ndarray, "frames 3"],
]:
    """Change of basis (x, y, z) → (x, z, −y) of a whole motion, its rest pose included."""
    rotations = local_rotations.copy()
    rotations[..., 1:] = turn_to_y_up(local_rotations[..., 1:])
    return skeleton_to_y_up(skeleton), turn_to_y_up(joint_positions), rotations, turn_to_y_up(root_translation)


def skeleton_to_y_up(skeleton: Skeleton) -> Skeleton:
    """Change of basis (x, y, z) → (x, z, −y) of a rest pose."""
    return replace(
        skeleton,
        offsets=turn_to_y_up(skeleton.offsets),
        end_sites=tuple((joint, (x, z, -y)) for joint, (x, y, z) in skeleton.end_sites),
    )


def turn_to_y_up(vectors: Float32[np.ndarray, "*shape 3"]) -> Float32[np.ndarray, "*shape 3"]:
    """Rotate vectors from z up to y up: (x, y, z) → (x, z, −y)."""
    return vectors[..., [0, 2, 1]] * np.array([1.0, 1.0, -1.0], np.float32)


def y_up_to_z_up(vectors: Float64[np.ndarray, "*shape 3"]) -> Float64[np.ndarray, "*shape 3"]:
    """The inverse of `turn_to_y_up`: (x, y, z) → (x, −z, y)."""
    return np.asarray(vectors[..., [0, 2, 1]] * np.array([1.0, -1.0, 1.0]))


def standing_metres(skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"]) -> float:
    """Median length from the ankles along the bones to the head; raises `SkeletonMapError` for unknown joints."""
    body = np.matmul(joint_map(skeleton, SMPL22.name).weights, joint_positions)
    return float(np.median(_chain_lengths(body)))


def is_plausible(metres: float) -> bool:
    """Whether this is a plausible length from ankle to head."""
    return _factor(metres, TYPICAL_HEIGHT_METRES) <= PLAUSIBLE_FACTOR


def _chain_lengths(body: Float32[np.ndarray, "frames 22 3"]) -> Float32[np.ndarray, "frames"]:
    first, second = np.array([(SMPL22.index(a), SMPL22.index(b)) for a, b in TRUNK_AND_LEGS]).T
    bones = np.linalg.norm(body[:, first] - body[:, second], axis=-1)
    lengths: Float32[np.ndarray, " frames"] = bones.sum(axis=-1)
    return lengths


def _factor(size: float, typical: float) -> float:
    return max(size / typical, typical / size) if size > 0 else np.inf


def _size(skeleton: Skeleton) -> tuple[float, float, str]:
    try:
        weights = joint_map(skeleton, SMPL22.name).weights
    except SkeletonMapError:
        return _longest_chain(skeleton), TYPICAL_CHAIN_METRES, "the longest chain"
    rest = weights @ rest_positions(skeleton)
    return float(_chain_lengths(rest[None])[0]), TYPICAL_HEIGHT_METRES, "ankle to head"


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
