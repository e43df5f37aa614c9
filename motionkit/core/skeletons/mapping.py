"""Maps known skeletons to the 22-joint (SMPL) and 21-joint (KIT) layouts, by tables of names and weights.

A family of skeletons (`motionkit.core.skeletons.families`) defines every joint of the layout as a weighted sum of the
family's joints (`X.tip` is the End Site of X). Missing toes are placed in front of the ankle.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Motion
from motionkit.core.plain_text import shortened
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import KIT21, SMPL22, STANDARD_SKELETONS, Skeleton
from motionkit.core.skeletons.families import (
    canonical_names,
    family_of,
    find_family,
    load_table,
    parse_layout_map,
)

# Offsets of an extrapolated toe ahead of and below the ankle, as shares of the shin: HumanML3D's skeleton has 0.14 m
# and 0.06 m for a shin of 0.43 m.
TOE_AHEAD, TOE_BELOW = 0.33, 0.14
# A row of which joints have less than this share is a tip.
MIN_JOINT_WEIGHT = 0.1
TOES = {"left_foot": ("left_ankle", "left_knee"), "right_foot": ("right_ankle", "right_knee")}


EndSites = tuple[tuple[int, tuple[float, float, float]], ...]


# Names shown in a message.
SHOWN_JOINTS, SHOWN_MISSING, LONGEST_NAME = 6, 3, 40


class SkeletonMapError(MotionkitError):
    """A skeleton that cannot be mapped to a layout; `missing` are the layout's joints without a source."""

    def __init__(self, skeleton: Skeleton, layout: str, missing: tuple[str, ...]) -> None:
        self.skeleton_name, self.layout, self.missing = skeleton.name, layout, missing
        shown = _some(skeleton.joint_names, SHOWN_JOINTS)
        table = (
            f"its own map {parse_layout_map(skeleton.layout_map).name!r} names" if skeleton.layout_map else "there is"
        )
        remedy = (
            "correct it and ingest again"
            if skeleton.layout_map
            else "`motionkit info FILE --init my-rig.toml` drafts a map for --skeleton-map (docs/formats.md)"
        )
        super().__init__(
            f"skeleton {skeleton.name!r} cannot be mapped to {layout}: {table} nothing for "
            f"{_some(missing, SHOWN_MISSING)} among its joints ({shown}); {remedy}"
        )

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild_error, (self.args[0], self.skeleton_name, self.layout, self.missing)


def _some(names: Sequence[str], most: int) -> str:
    more = f" and {len(names) - most:,} more" if len(names) > most else ""
    return ", ".join(shortened(name, LONGEST_NAME) for name in names[:most]) + more


def _rebuild_error(message: str, skeleton_name: str, layout: str, missing: tuple[str, ...]) -> SkeletonMapError:
    error = SkeletonMapError.__new__(SkeletonMapError)
    error.args = (message,)
    error.skeleton_name, error.layout, error.missing = skeleton_name, layout, missing
    return error


@dataclass(frozen=True, eq=False)
class JointMap:
    """Every joint of a layout as a weighted sum of source joints and End Site tips; the weights of a row sum to 1.

    `made_up` are the extrapolated toes; `unmapped` the source joints that no row uses.
    """

    layout: str
    family: str
    weights: Float32[np.ndarray, "layout_joints joints"]
    tip_weights: Float32[np.ndarray, "layout_joints tips"]
    made_up: tuple[str, ...]
    unmapped: tuple[str, ...]


def map_joints(motion: Motion, layout: str) -> Float32[np.ndarray, "frames layout_joints 3"]:
    """Joint positions in metres in the layout "smpl22", "kit21" or "native" (the motion's own joints).

    Raises `SkeletonMapError` naming the layout's joints that the skeleton does not have.
    """
    if layout == "native":
        return motion.joint_positions
    mapping = joint_map(motion.skeleton, layout)
    if mapping.family == layout:
        return motion.joint_positions
    mapped = _weighted(motion.joint_positions, mapping.weights)
    if mapping.tip_weights.any():
        mapped += _weighted(_tips(motion), mapping.tip_weights)
    if mapping.made_up:
        if layout == "kit21":
            body = _weighted(motion.joint_positions, joint_map(motion.skeleton, "smpl22").weights)
            return _weighted(_with_toes(body, mapping.made_up), _kit21_from_smpl22())
        mapped = _with_toes(mapped, mapping.made_up)
    return mapped


def body_axis(
    skeleton: Skeleton, joint_positions: Float32[np.ndarray, "frames joints 3"]
) -> Float32[np.ndarray, "frames 3"]:
    """The vector from between the ankles to the head, in metres; raises `SkeletonMapError` for unknown joints.

    A head or an ankle that is only an unnamed tip is replaced by the next joint of the trunk or the leg.
    """
    weights = joint_map(skeleton, SMPL22.name).weights
    head, left, right = (
        _first_of(weights, names)
        for names in (("head", "neck"), ("left_ankle", "left_knee"), ("right_ankle", "right_knee"))
    )
    vectors: Float32[np.ndarray, "frames 3"] = np.matmul(head - np.float32(0.5) * (left + right), joint_positions)
    return vectors


def _first_of(weights: Float32[np.ndarray, "22 joints"], names: tuple[str, ...]) -> Float32[np.ndarray, "joints"]:
    # Rows that use tips sum to less than 1 over the joints.
    rows = [weights[SMPL22.index(name)] for name in names]
    row = next((row for row in rows if row.sum() > MIN_JOINT_WEIGHT), rows[-1])
    return np.asarray(row / row.sum())


def rest_positions(skeleton: Skeleton) -> Float32[np.ndarray, "joints 3"]:
    """Joint positions of the rest pose: every offset added to its parent's position, in metres."""
    positions: list[tuple[float, float, float]] = []
    for (x, y, z), parent in zip(skeleton.offsets.tolist(), skeleton.parents, strict=True):
        above = positions[parent] if parent >= 0 else (0.0, 0.0, 0.0)
        positions.append((above[0] + x, above[1] + y, above[2] + z))
    return np.array(positions, np.float32)


def joint_map(skeleton: Skeleton, layout: str) -> JointMap:
    """The map of a skeleton to a layout; raises `SkeletonMapError` if a joint has no source."""
    if layout not in STANDARD_SKELETONS:
        raise ValueError(f"layout {layout!r} is not one of {', '.join(STANDARD_SKELETONS)}")
    target = STANDARD_SKELETONS[layout]
    if skeleton.joint_names == target.joint_names and not skeleton.layout_map:
        eye = np.eye(target.num_joints, dtype=np.float32)
        return JointMap(layout, layout, eye, np.zeros((len(eye), len(skeleton.end_sites)), np.float32), (), ())
    body = _map_to_smpl22(skeleton.joint_names, skeleton.end_sites, skeleton.layout_map)
    if isinstance(body, tuple):
        raise SkeletonMapError(skeleton, layout, body)
    if layout == SMPL22.name:
        return body
    via = _kit21_from_smpl22()
    return JointMap(layout, body.family, via @ body.weights, via @ body.tip_weights, body.made_up, body.unmapped)


def family_unit_metres(skeleton: Skeleton) -> float | None:
    """The length unit of the family's files in metres, if known (the CMU database's)."""
    family = family_of(skeleton)
    return family.metres_per_unit if family else None


@lru_cache(maxsize=1024)
def _map_to_smpl22(joint_names: tuple[str, ...], end_sites: EndSites, layout_map: str) -> JointMap | tuple[str, ...]:
    # The map, or the layout's joints without a source.
    names = canonical_names(joint_names)
    family = parse_layout_map(layout_map) if layout_map else find_family(names)
    if family is None:
        return SMPL22.joint_names
    columns = {family.aliases.get(name, name): joint for joint, name in reversed(list(enumerate(names)))}
    tips = {f"{names[joint]}.tip": column for column, (joint, _) in enumerate(end_sites)}
    weights = np.zeros((SMPL22.num_joints, len(names)), np.float32)
    tip_weights = np.zeros((SMPL22.num_joints, len(end_sites)), np.float32)
    missing: list[str] = []
    made_up: list[str] = []
    for row, joint_name in enumerate(SMPL22.joint_names):
        terms = next((way for way in family.rows[joint_name] if _possible(way, columns, tips, end_sites)), None)
        if terms is None:
            (made_up if joint_name in TOES else missing).append(joint_name)
            continue
        for source, weight in terms.items():
            if source in columns:
                weights[row, columns[source]] += weight
            else:
                tip_weights[row, tips[source]] += weight
    if missing:
        return tuple(missing)
    unmapped = tuple(name for name, used in zip(joint_names, np.any(weights, axis=0).tolist(), strict=True) if not used)
    return JointMap(SMPL22.name, family.name, weights, tip_weights, tuple(made_up), unmapped)


def _possible(
    way: Mapping[str, float], columns: Mapping[str, int], tips: Mapping[str, int], end_sites: EndSites
) -> bool:
    # A tip without length gives no toe.
    return all(
        source in columns or (source in tips and np.linalg.norm(end_sites[tips[source]][1]) > 0.02) for source in way
    )


def _weighted(
    positions: Float32[np.ndarray, "frames joints 3"], weights: Float32[np.ndarray, "rows joints"]
) -> Float32[np.ndarray, "frames rows 3"]:
    mapped: Float32[np.ndarray, "frames rows 3"] = np.matmul(weights, positions)
    return mapped


def _tips(motion: Motion) -> Float32[np.ndarray, "frames tips 3"]:
    # World positions of the End Sites, by rotations if available; otherwise they continue their bone.
    skeleton, positions = motion.skeleton, motion.joint_positions
    joints = [joint for joint, _ in skeleton.end_sites]
    offsets = np.array([offset for _, offset in skeleton.end_sites], np.float32)
    if motion.local_rotations is None:
        parents = [max(skeleton.parents[joint], 0) for joint in joints]
        bones = positions[:, joints] - positions[:, parents]
        lengths = np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-6)
        extended: Float32[np.ndarray, "frames tips 3"] = (
            positions[:, joints] + bones / lengths * np.linalg.norm(offsets, axis=-1)[:, None]
        )
        return extended
    turned = np.repeat(offsets[None], motion.num_frames, axis=0)
    for column, joint in enumerate(joints):
        while joint >= 0:
            turned[:, column] = kinematics.quaternion_rotate(motion.local_rotations[:, joint], turned[:, column])
            joint = skeleton.parents[joint]
    return positions[:, joints] + turned


def _with_toes(
    body: Float32[np.ndarray, "frames 22 3"], made_up: tuple[str, ...]
) -> Float32[np.ndarray, "frames 22 3"]:
    # Forward is the hips' facing direction, orthogonalised to the shin.
    body = body.copy()
    across = body[:, SMPL22.index("left_hip")] - body[:, SMPL22.index("right_hip")]
    for toe in made_up:
        ankle, knee = (body[:, SMPL22.index(name)] for name in TOES[toe])
        shin = ankle - knee
        length = np.maximum(np.linalg.norm(shin, axis=-1, keepdims=True), 1e-6)
        down = shin / length
        ahead = np.cross(down, across)
        ahead /= np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-6)
        body[:, SMPL22.index(toe)] = ankle + length * (TOE_AHEAD * ahead + TOE_BELOW * down)
    return body


@cache
def _kit21_from_smpl22() -> Float32[np.ndarray, "21 22"]:
    table = load_table("kit21_from_smpl22.toml")["kit21"]
    weights = np.zeros((KIT21.num_joints, SMPL22.num_joints), np.float32)
    for row, joint_name in enumerate(KIT21.joint_names):
        entry = table[joint_name]
        for source, weight in ({entry: 1.0} if isinstance(entry, str) else entry).items():
            weights[row, SMPL22.index(source)] = weight
    return weights
