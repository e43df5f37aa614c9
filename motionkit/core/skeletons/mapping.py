"""Maps of skeletons to the 22-joint (SMPL) and 21-joint (KIT) layouts, by tables of joint names and weights.

A family of skeletons is a TOML table: the joints that identify it, and each joint of the layout as a weighted sum of
the family's joints (`X.tip` is the End Site of X). Families are shipped here; a user's own table (`ingest
--skeleton-map my-rig.toml`) is stored with the skeletons that it fits as canonical JSON (`Skeleton.layout_map`).
Missing toes are placed in front of the ankle.
"""

import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError, MotionkitError, shown
from motionkit.core.files import LONGEST_TOML, parse_json, parse_toml, read_at_most
from motionkit.core.motion import Motion
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import KIT21, SMPL22, STANDARD_SKELETONS, Skeleton

# Offsets of an extrapolated toe ahead of and below the ankle, as shares of the shin: HumanML3D's skeleton has 0.14 m
# and 0.06 m for a shin of 0.43 m.
TOE_AHEAD, TOE_BELOW = 0.33, 0.14
# A row of which joints have less than this share is a tip.
MIN_JOINT_WEIGHT = 0.1
# Missing toes can be extrapolated; every other joint of the layout needs a row.
TOES = {"left_foot": ("left_ankle", "left_knee"), "right_foot": ("right_ankle", "right_knee")}
KEYS = ("name", "source", "requires", "aliases", "units_per_metre", "smpl22")
REASON = "skeleton-map"

SPINE = tuple(SMPL22.index(name) for name in ("spine1", "spine2", "spine3"))
PELVIS, LEFT_HIP, RIGHT_HIP = (SMPL22.index(name) for name in ("pelvis", "left_hip", "right_hip"))

Way = Mapping[str, float]


@dataclass(frozen=True)
class SkeletonFamily:
    """A kind of skeleton: `requires` (canonical names) identifies it, `rows` map its joints to the layout's.

    A row lists alternatives, of which the first possible one is used; each is a weighted sum of joints and `X.tip`.
    `metres_per_unit` is the length unit of the family's files, if known.
    """

    name: str
    requires: frozenset[str]
    aliases: Mapping[str, str]
    rows: Mapping[str, tuple[Way, ...]]
    metres_per_unit: float | None


def read_skeleton_map(path: Path) -> str:
    """Read a user's TOML file as canonical text; raises `FormatError` (`skeleton-map`) with advice."""
    try:
        text = read_at_most(path, LONGEST_TOML).decode("utf-8-sig")
    except OSError as error:
        raise FormatError(f"cannot be read ({error.strerror or error})", path=path, reason="unreadable") from None
    except UnicodeDecodeError as error:
        raise FormatError(f"not UTF-8 ({error.reason})", path=path, reason=REASON) from None
    try:
        table = parse_toml(text)
    except ValueError as error:
        line = re.search(r"at line (\d+)", str(error))
        raise FormatError(
            f"no TOML ({error}); the form is described in docs/formats.md, Standard layouts",
            path=path,
            reason=REASON,
            line=int(line[1]) if line else text.count("\n") + 1,
        ) from None
    try:
        _family(table)
        return json.dumps(table, sort_keys=True, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    except (ValueError, TypeError) as error:
        raise FormatError(str(error), path=path, reason=REASON) from None


@lru_cache(maxsize=256)
def parse_layout_map(text: str) -> SkeletonFamily:
    """The family that a skeleton's `layout_map` describes; raises `MotionkitError` for any other text."""
    try:
        return _family(parse_json(text))
    except ValueError as error:
        raise MotionkitError(f"the layout map of a skeleton cannot be read: {error}") from None


def with_layout_map(skeleton: Skeleton, layout_maps: Sequence[str]) -> Skeleton:
    """The skeleton with the most specific matching map of `layout_maps`; unchanged if none matches."""
    names = canonical_names(skeleton.joint_names)
    fitting = [text for text in layout_maps if fits(parse_layout_map(text), names)]
    if not fitting or skeleton.layout_map:
        return skeleton
    return replace(skeleton, layout_map=max(fitting, key=lambda text: len(parse_layout_map(text).requires)))


def fits(family: SkeletonFamily, names: Sequence[str]) -> bool:
    """Whether canonical joint names hold all that the family requires."""
    return family.requires <= {family.aliases.get(name, name) for name in names}


@lru_cache(maxsize=1024)
def canonical_names(joint_names: tuple[str, ...]) -> tuple[str, ...]:
    """Normalised joint names: "mixamorig:LeftArm", "Character1_LeftArm" and "left arm" are the same joint."""
    plain = [name.rsplit(":", 1)[-1] for name in joint_names]
    prefixes = Counter(name.split("_", 1)[0] for name in plain if "_" in name)
    for prefix, count in prefixes.most_common(1):
        if 2 * count > len(plain):
            plain = [name.removeprefix(f"{prefix}_") for name in plain]
    return tuple(_canonical(name) for name in plain)


def _shipped_tables() -> list[dict[str, Any]]:
    files = resources.files("motionkit.core.skeletons").iterdir()
    return [parse_toml(file.read_text(encoding="utf-8")) for file in files if file.name.endswith(".toml")]


@cache
def shipped_families() -> tuple[SkeletonFamily, ...]:
    """All shipped families, the most specific first, because general ones match its skeletons too."""
    # The table of DeepMimic's humanoid has its joints' axes too, for its reader.
    tables = [{key: table[key] for key in KEYS if key in table} for table in _shipped_tables() if "smpl22" in table]
    families = [_family(table) for table in tables]
    return tuple(sorted(families, key=lambda family: (-len(family.requires), family.name)))


@lru_cache(maxsize=1024)
def find_family(names: tuple[str, ...]) -> SkeletonFamily | None:
    """The most specific shipped family that canonical joint names match."""
    return next((family for family in shipped_families() if fits(family, names)), None)


def rig_name(joint_names: tuple[str, ...]) -> str:
    """A name for a skeleton whose file gives none: its family's, else its root joint's."""
    family = find_family(canonical_names(joint_names))
    return joint_names[0] if family is None else family.name


def draft_map(skeleton: Skeleton, name: str) -> str:
    """A table for `read_skeleton_map` as TOML text, of joint names that shipped families have, to be completed."""
    names = canonical_names(skeleton.joint_names)
    sources: dict[str, str] = {}
    known = [({family.aliases.get(name, name): name for name in names}, family.rows) for family in shipped_families()]
    for row in SMPL22.joint_names:
        ways = ((joint, named) for named, rows in known for way in rows[row] for joint in way if len(way) == 1)
        sources[row] = next((named[joint] for joint, named in ways if joint in named), "")
    requires = json.dumps(list(dict.fromkeys(filter(None, sources.values()))))
    lines = [f'{row} = "{joint}"' if joint else f'# {row} = ""' for row, joint in sources.items()]
    head = "# Drafted from joint names: correct it, and complete the rows that begin with #."
    return "\n".join((head, f"name = {json.dumps(name)}", f"requires = {requires}", "", "[smpl22]", *lines, ""))


def _canonical(name: str) -> str:
    stem, dot, tip = name.partition(".tip")
    return re.sub(r"[^a-z0-9]", "", stem.lower()) + (dot + tip if dot else "")


def _family(table: Any) -> SkeletonFamily:
    # Every ValueError is a message for the author of the table.
    if not isinstance(table, dict):
        raise ValueError("expected a table with name, requires and [smpl22]")
    unknown = sorted(set(table) - set(KEYS))
    if unknown:
        raise ValueError(f"unknown key {shown(unknown[0])}, expected {', '.join(KEYS)}")
    name = table.get("name")
    if not isinstance(name, str) or not name.strip() or name in STANDARD_SKELETONS:
        raise ValueError(f"name = {shown(name)}, expected a text other than {', '.join(STANDARD_SKELETONS)}")
    requires = table.get("requires")
    if not isinstance(requires, list) or not requires or not all(isinstance(joint, str) for joint in requires):
        raise ValueError(
            'requires is missing; it lists the joints by which the skeleton is known: ["Pelvis", "Thigh_L"]'
        )
    aliases = table.get("aliases", {})
    if not isinstance(aliases, dict) or not all(isinstance(joint, str) for joint in aliases.values()):
        raise ValueError('[aliases] holds lines of the form OtherName = "Name"')
    units = table.get("units_per_metre")
    if units is not None and not (_is_number(units) and 1e-6 < units < 1e6):
        raise ValueError(f"units_per_metre = {shown(units)}, expected a positive number such as 100 for centimetres")
    return SkeletonFamily(
        name=name,
        requires=frozenset(_canonical(joint) for joint in requires),
        aliases={_canonical(key): _canonical(value) for key, value in aliases.items()},
        rows=_rows(table.get("smpl22")),
        metres_per_unit=1.0 / units if units is not None else None,
    )


def _rows(table: Any) -> Mapping[str, tuple[Way, ...]]:
    if not isinstance(table, dict):
        raise ValueError("no table [smpl22]; it says for each joint of the layout where it comes from")
    unknown = sorted(set(table) - set(SMPL22.joint_names))
    if unknown:
        raise ValueError(
            f"[smpl22] has {shown(unknown[0])}, which is no joint of the layout: {', '.join(SMPL22.joint_names)}"
        )
    missing = [joint for joint in SMPL22.joint_names if joint not in table and joint not in TOES]
    if missing:
        raise ValueError(f"[smpl22] says nothing about {', '.join(missing)}; only the feet can be left out")
    rows = {}
    for joint in SMPL22.joint_names:
        entry = table.get(joint, [])
        rows[joint] = tuple(_way(joint, way) for way in (entry if isinstance(entry, list) else [entry]))
    return rows


def _way(joint: str, way: Any) -> Way:
    """One alternative of a row: a joint's name, or a table of weights."""
    if isinstance(way, str) and way.strip():
        return {_canonical(way): 1.0}
    if not isinstance(way, dict) or not way or not all(_is_number(weight) for weight in way.values()):
        raise ValueError(
            f"{joint} = {shown(way)}, expected a joint's name, weights such as {{ A = 0.6, B = 0.4 }}, or a list"
        )
    total = math.fsum(way.values())
    if abs(total - 1.0) > 1e-6:
        raise ValueError(f"the weights of {joint} sum to {total:g}, expected 1")
    return {_canonical(source): float(weight) for source, weight in way.items()}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e9 < value < 1e9


class SkeletonMapError(MotionkitError):
    """A skeleton that cannot be mapped to a layout; `missing` are the layout's joints without a source."""

    def __init__(self, skeleton: Skeleton, layout: str, missing: tuple[str, ...]) -> None:
        self.skeleton, self.layout, self.missing = skeleton, layout, missing
        table = "there is"
        remedy = "`motionkit info FILE --init my-rig.toml` drafts a map for --skeleton-map (docs/formats.md)"
        if skeleton.layout_map:
            table = f"its own map {parse_layout_map(skeleton.layout_map).name!r} names"
            remedy = "correct it and ingest again"
        super().__init__(
            f"skeleton {skeleton.name!r} cannot be mapped to {layout}: {table} nothing for "
            f"{shown(missing)} among its joints {shown(skeleton.joint_names)}; {remedy}"
        )

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.skeleton, self.layout, self.missing)


@dataclass(frozen=True, eq=False)
class JointMap:
    """Every joint of a layout as a weighted sum of source joints and End Site tips; the weights of a row sum to 1.

    `made_up` are the extrapolated toes.
    """

    family: str
    weights: Float32[np.ndarray, "layout_joints joints"]
    tip_weights: Float32[np.ndarray, "layout_joints tips"]
    made_up: tuple[str, ...]


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
        return JointMap(layout, eye, np.zeros((len(eye), len(skeleton.end_sites)), np.float32), ())
    body = _map_to_smpl22(skeleton.joint_names, skeleton.end_sites, skeleton.layout_map)
    if isinstance(body, tuple):
        raise SkeletonMapError(skeleton, layout, body)
    if layout == SMPL22.name:
        return body
    via = _kit21_from_smpl22()
    return JointMap(body.family, via @ body.weights, via @ body.tip_weights, body.made_up)


@lru_cache(maxsize=64)
def counterpart_joints(skeleton: Skeleton) -> Mapping[int, int]:
    """Source joints that correspond to joints of the 22, by the layout's index; raises `SkeletonMapError`.

    A joint of the layout maps to its farthest source from the root, among those of weight 0.5 or more. If several
    share a source, the last one of the spine gets it, as the arms are attached there, else the one with the largest
    weight. The pelvis is where the legs meet.
    """
    weights = joint_map(skeleton, SMPL22.name).weights
    wanting: dict[int, list[int]] = {}
    for joint in range(SMPL22.num_joints):
        sources = np.flatnonzero(weights[joint] >= 0.5).tolist()
        if joint != PELVIS and sources:
            wanting.setdefault(max(sources, key=lambda source: len(skeleton.path_to_root(source))), []).append(joint)
    counterparts = {}
    for source, joints in wanting.items():
        spine = [joint for joint in joints if joint in SPINE]
        counterparts[spine[-1] if spine else max(joints, key=lambda joint: float(weights[joint, source]))] = source
    hips = [skeleton.path_to_root(counterparts[hip]) for hip in (LEFT_HIP, RIGHT_HIP) if hip in counterparts]
    pelvis = next((joint for joint in hips[0] if all(joint in above for above in hips)), 0) if hips else 0
    counterparts = {joint: source for joint, source in counterparts.items() if source != pelvis}
    return MappingProxyType(dict(sorted({**counterparts, PELVIS: pelvis}.items())))


def family_unit_metres(skeleton: Skeleton) -> float | None:
    """The length unit of the family's files in metres, if known (the CMU database's)."""
    own = skeleton.layout_map
    family = parse_layout_map(own) if own else find_family(canonical_names(skeleton.joint_names))
    return family.metres_per_unit if family else None


EndSites = tuple[tuple[int, tuple[float, float, float]], ...]


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
    return JointMap(family.name, weights, tip_weights, tuple(made_up))


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
    table = next(table["kit21"] for table in _shipped_tables() if "kit21" in table)
    weights = np.zeros((KIT21.num_joints, SMPL22.num_joints), np.float32)
    for row, joint_name in enumerate(KIT21.joint_names):
        entry = table[joint_name]
        for source, weight in ({entry: 1.0} if isinstance(entry, str) else entry).items():
            weights[row, SMPL22.index(source)] = weight
    return weights
