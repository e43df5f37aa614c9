"""Families of skeletons as data: the joints that identify one, and its map to the 22-joint layout.

The tables are TOML files: those shipped here, and the user's (`ingest --skeleton-map my-rig.toml`), which are stored
with the skeletons they match as canonical JSON (`Skeleton.layout_map`).
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
from typing import Any

from motionkit.core.errors import FormatError, MotionkitError
from motionkit.core.files import read_at_most
from motionkit.core.plain_text import LONGEST_TOML, parse_json, parse_toml, shown
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS, Skeleton

# Missing toes can be extrapolated; every other joint of the layout needs a row.
OPTIONAL_ROWS = frozenset(("left_foot", "right_foot"))
KEYS = ("name", "source", "requires", "aliases", "units_per_metre", "smpl22")
REASON = "skeleton-map"

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


def family_of(skeleton: Skeleton) -> SkeletonFamily | None:
    """The skeleton's own map, or the shipped family that it belongs to, or None."""
    if skeleton.layout_map:
        return parse_layout_map(skeleton.layout_map)
    return find_family(canonical_names(skeleton.joint_names))


def fits(family: SkeletonFamily, names: Sequence[str]) -> bool:
    """Whether canonical joint names hold all that the family requires."""
    return family.requires <= {family.aliases.get(name, name) for name in names}


@lru_cache(maxsize=1024)
def canonical_names(joint_names: tuple[str, ...]) -> tuple[str, ...]:
    """Normalised joint names: "mixamorig:LeftArm", "Character1_LeftArm" and "left arm" are the same joint."""
    plain = [name.rsplit(":", 1)[-1] for name in joint_names]
    prefix, count = (
        Counter(name.split("_", 1)[0] for name in plain if "_" in name).most_common(1)[0]
        if any("_" in name for name in plain)
        else ("", 0)
    )
    if 2 * count > len(plain):
        plain = [name.removeprefix(f"{prefix}_") for name in plain]
    return tuple(_canonical(name) for name in plain)


def load_table(name: str) -> dict[str, Any]:
    """The text of a shipped TOML file."""
    return parse_toml((resources.files("motionkit.core.skeletons") / name).read_text(encoding="utf-8"))


@cache
def shipped_families() -> tuple[SkeletonFamily, ...]:
    """All shipped families, the most specific first, because general ones match its skeletons too."""
    names = (
        entry.name for entry in resources.files("motionkit.core.skeletons").iterdir() if entry.name.endswith(".toml")
    )
    tables = [table for table in map(load_table, names) if "smpl22" in table]
    families = [_family({key: table[key] for key in KEYS if key in table}) for table in tables]
    return tuple(sorted(families, key=lambda family: (-len(family.requires), family.name)))


@lru_cache(maxsize=1024)
def find_family(names: tuple[str, ...]) -> SkeletonFamily | None:
    """The most specific shipped family that canonical joint names match."""
    return next((family for family in shipped_families() if fits(family, names)), None)


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
    if not isinstance(table.get("source", ""), str):
        raise ValueError("source is not a text; it says where the names are from")
    aliases = table.get("aliases", {})
    if not isinstance(aliases, dict) or not all(isinstance(joint, str) for joint in aliases.values()):
        raise ValueError('[aliases] holds lines of the form OtherName = "Name"')
    return SkeletonFamily(
        name=name,
        requires=frozenset(_canonical(joint) for joint in requires),
        aliases={_canonical(key): _canonical(value) for key, value in aliases.items()},
        rows=_rows(table.get("smpl22")),
        metres_per_unit=_metres_per_unit(table.get("units_per_metre")),
    )


def _metres_per_unit(units_per_metre: Any) -> float | None:
    if units_per_metre is None:
        return None
    if not _is_number(units_per_metre) or not 1e-6 < units_per_metre < 1e6:
        raise ValueError(
            f"units_per_metre = {shown(units_per_metre)}, expected a positive number such as 100 for centimetres"
        )
    return 1.0 / float(units_per_metre)


def _rows(table: Any) -> Mapping[str, tuple[Way, ...]]:
    if not isinstance(table, dict):
        raise ValueError("no table [smpl22]; it says for each joint of the layout where it comes from")
    unknown = sorted(set(table) - set(SMPL22.joint_names))
    if unknown:
        raise ValueError(
            f"[smpl22] has {shown(unknown[0])}, which is no joint of the layout: {', '.join(SMPL22.joint_names)}"
        )
    missing = [joint for joint in SMPL22.joint_names if joint not in table and joint not in OPTIONAL_ROWS]
    if missing:
        raise ValueError(f"[smpl22] says nothing about {', '.join(missing)}; only the feet can be left out")
    return {joint: _ways(joint, table.get(joint, [])) for joint in SMPL22.joint_names}


def _ways(joint: str, entry: Any) -> tuple[Way, ...]:
    # A joint is a name, a table of weights, or a list of alternatives.
    return tuple(_way(joint, way) for way in (entry if isinstance(entry, list) else [entry]))


def _way(joint: str, way: Any) -> Way:
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
