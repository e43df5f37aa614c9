"""Inference of a source's unit from the size of the body; lengths in metres."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, family_unit_metres, joint_map, rest_positions

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "1/0.45 inch": 0.0254 / 0.45}
# From the ankles through the hips to the base of the skull: 1.45 m in SMPL's mean body.
TYPICAL_HEIGHT_METRES = 1.45
# For a skeleton with unknown names, the longest chain from the root to a fingertip or a toe.
TYPICAL_CHAIN_METRES = 1.25
PLAUSIBLE_FACTOR = 2.2
# Characters may be giants, if somebody says so; units differ by 10 and more.
GIVEN_UNIT_FACTOR = 5.0
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


def standing_metres(skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"]) -> float:
    """Median length from the ankles along the bones to the head; raises `SkeletonMapError` for unknown joints."""
    body = np.matmul(joint_map(skeleton, SMPL22.name).weights, joint_positions)
    return float(np.median(_chain_lengths(body)))


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
        raise FormatError(
            f"a unit of {unit_metres:g} m makes a body of {metres:.3g} m from ankles to head, people have "
            f"{TYPICAL_HEIGHT_METRES} m: expected a unit of about "
            f"{unit_metres * TYPICAL_HEIGHT_METRES / metres:.2g} m",
            path=path,
            reason="unit",
        )


def is_plausible(metres: float) -> bool:
    """Whether this is a plausible length from ankle to head."""
    return _factor(metres, TYPICAL_HEIGHT_METRES) <= PLAUSIBLE_FACTOR


def logged_unit(operations: Sequence[str]) -> tuple[float, str]:
    """Metres per unit of a source by its motion's operation log, and how that was found; 1 where nothing was scaled."""
    found = next(filter(None, (re.match(r"lengths × (\S+) to metres \((.+)\)", line) for line in operations)), None)
    return (1.0, "metres") if found is None else (float(found[1]), found[2])


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
