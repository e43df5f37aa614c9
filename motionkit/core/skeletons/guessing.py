"""Drafts a rig's map to the 22 joints: limbs by the tree, their joints by names, the spine by position."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from motionkit.core.errors import MotionkitError
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.families import canonical_names
from motionkit.core.skeletons.mapping import rest_positions

SHORTEST_LIMB = 3
SIDE = re.compile(r"([Ll]eft|[Rr]ight|LEFT|RIGHT)|^(?:.*:)?([lrLR])(?=[A-Z_. ])|[_. ]([lrLR])(?=$|[_. ])")
# Words in joints' names, in the order of a limb, the most reliable first; each part is below the previous one.
LEG = {
    "hip": (r"thigh|up(per)?[ _]?leg|hip|femur", r"^leg"),
    "knee": (r"knee|shin|calf|low(er)?[ _]?leg|tibia", r"(?<!up)(?<!upper)leg"),
    "ankle": (r"ankle|foot",),
    "foot": (r"toe|ball",),
}
ARM = {
    "collar": (r"collar|clavicle|shoulder",),
    "shoulder": (r"shldr|up(per)?[ _]?arm|humerus", r"shoulder|^arm"),
    "elbow": (r"elbow|(fore|low(er)?)[ _]?arm|radius",),
    "wrist": (r"wrist|hand",),
}
# Positions of SMPL's spine joints between pelvis and neck.
HEIGHTS = {"spine1": 0.22, "spine2": 0.47, "spine3": 0.59}

Entry = str | dict[str, float]


def guess_map(skeleton: Skeleton) -> dict[str, Entry]:
    """A guessed source of each of the 22 joints: a joint's name, or weights; feet without a joint are omitted.

    Raises `MotionkitError` if the tree is not a body: two legs on one joint, two arms on one above it.
    """
    names, children = skeleton.joint_names, [skeleton.children(joint) for joint in range(skeleton.num_joints)]
    chains = _chains(skeleton)
    pairs = {
        above: pair for above, below in enumerate(children) if (pair := _pair(below, skeleton, chains)) is not None
    }
    legs_on = next((above for above, pair in pairs.items() if _parts(chains[pair[0]], LEG, names)), None)
    arms_on = next((above for above, pair in pairs.items() if _parts(chains[pair[0]], ARM, names)), None)
    if legs_on is None or arms_on is None:
        raise MotionkitError(
            f"skeleton {skeleton.name!r} is no body by its tree: a left and a right "
            f"{'leg' if legs_on is None else 'arm'} on one joint were expected, by names such as LeftUpLeg, thigh_l or "
            "upperleg01.L"
        )
    found = {"pelvis": legs_on}
    for place, side in enumerate(("left", "right")):
        found |= {f"{side}_{part}": joint for part, joint in _parts(chains[pairs[legs_on][place]], LEG, names).items()}
        found |= {f"{side}_{part}": joint for part, joint in _parts(chains[pairs[arms_on][place]], ARM, names).items()}
    above = [joint for joint in children[arms_on] if joint not in pairs[arms_on]]
    upward = max((chains[joint] for joint in above), key=len, default=[])
    head = next((joint for joint in upward if "head" in names[joint].lower()), upward[-1] if upward else None)
    if head is None:
        raise MotionkitError(f"skeleton {skeleton.name!r}: nothing above {names[arms_on]} could be the head")
    neck = upward[0] if upward[0] != head else None
    made: dict[str, Entry] = {part: names[joint] for part, joint in (*found.items(), ("head", head))}
    shoulders = [names[found[f"{side}_shoulder"]] for side in ("left", "right")]
    made["neck"] = names[neck] if neck is not None else dict.fromkeys(shoulders, 0.5)
    for side, shoulder in zip(("left", "right"), shoulders, strict=True):
        other = names[neck] if neck is not None else shoulders[shoulder == shoulders[0]]
        made.setdefault(
            f"{side}_collar", {other: 0.6, shoulder: 0.4} if neck is not None else {other: 0.3, shoulder: 0.7}
        )
    made |= _spine(skeleton, legs_on, arms_on, neck if neck is not None else head)
    return {joint: made[joint] for joint in SMPL22.joint_names if joint in made}


def map_text(skeleton: Skeleton, name: str) -> str:
    """A skeleton map (docs/formats.md, Standard layouts) as TOML; raises `MotionkitError` as `guess_map` does."""
    short = dict(zip(skeleton.joint_names, _short_names(skeleton.joint_names), strict=True))
    made: dict[str, Entry] = {
        joint: short[entry] if isinstance(entry, str) else {short[each]: share for each, share in entry.items()}
        for joint, entry in guess_map(skeleton).items()
    }
    required = [entry for joint, entry in made.items() if isinstance(entry, str) and "spine" not in joint]
    lines = [f"{joint} = {_toml(entry)}" for joint, entry in made.items()]
    head = f"# Guessed from names and the tree: correct what is wrong.\nname = {_toml(name)}\nrequires = "
    return f"{head}[{', '.join(map(_toml, required))}]\n\n[smpl22]\n" + "\n".join(lines) + "\n"


def _short_names(names: tuple[str, ...]) -> Iterator[str]:
    """Names as in maps: without a namespace or common prefix."""
    for name, compared in zip(names, canonical_names(names), strict=True):
        plain = name.rsplit(":", 1)[-1]
        yield plain if re.sub("[^a-z0-9]", "", plain.lower()) == compared else plain.partition("_")[2] or compared


def _toml(entry: Entry) -> str:
    if isinstance(entry, str):
        return json.dumps(entry, ensure_ascii=False)
    return f"{{ {', '.join(f'{_toml(joint)} = {share:g}' for joint, share in entry.items())} }}"


def _chains(skeleton: Skeleton) -> list[list[int]]:
    """The longest chain below each joint, without side branches such as fingers and toes."""
    chains = [[joint] for joint in range(skeleton.num_joints)]
    for joint in range(skeleton.num_joints - 1, 0, -1):
        above = skeleton.parents[joint]
        if len(chains[joint]) + 1 >= len(chains[above]):
            chains[above] = [above, *chains[joint]]
    return chains


def _pair(joints: Sequence[int], skeleton: Skeleton, chains: Sequence[Sequence[int]]) -> tuple[int, int] | None:
    """A left and a right joint among siblings, by their names."""
    sides: dict[tuple[str, str], int] = {}
    for joint in joints:
        found = SIDE.search(skeleton.joint_names[joint])
        if found is not None and len(chains[joint]) >= SHORTEST_LIMB:
            side = next(group for group in found.groups() if group)[0].lower()
            sides[side, _stem(skeleton.joint_names[joint])] = joint
    return next(
        ((sides["l", stem], sides["r", stem]) for side, stem in sides if side == "l" and ("r", stem) in sides), None
    )


def _stem(name: str) -> str:
    return SIDE.sub(" ", name, count=1).rsplit(":", 1)[-1].strip(" _.").lower()


def _parts(chain: Sequence[int], limb: Mapping[str, tuple[str, ...]], names: Sequence[str]) -> dict[str, int]:
    """The joints of a limb by part; empty if an inner one is not found."""
    found: dict[str, int] = {}
    rest = list(chain)
    for part, patterns in limb.items():
        fitting = (each for words in patterns for each in rest if re.search(words, _stem(names[each])))
        joint = next(fitting, None)
        if joint is not None:
            found[part] = joint
            rest = rest[rest.index(joint) + 1 :]
    if "collar" in limb and "shoulder" not in found and "collar" in found:
        found["shoulder"] = found.pop("collar")
    needed = {"hip", "knee", "ankle"} if limb is LEG else {"shoulder", "elbow", "wrist"}
    return found if needed <= found.keys() else {}


def _spine(skeleton: Skeleton, pelvis: int, chest: int, neck: int) -> dict[str, Entry]:
    """The spine's joints as points between those of the rig, by their relative position from pelvis to neck."""
    way = [neck]
    while way[-1] != pelvis and skeleton.parents[way[-1]] >= 0:
        way.append(skeleton.parents[way[-1]])
    way.reverse()
    rest = rest_positions(skeleton)[way].astype(np.float64)
    along = np.insert(np.cumsum(np.linalg.norm(np.diff(rest, axis=0), axis=1)), 0, 0.0)
    if along[-1] <= 0:  # markers have no bones: space evenly
        along = np.arange(len(way), dtype=np.float64)
    made: dict[str, Entry] = {}
    for joint, share in HEIGHTS.items():
        at = share * along[-1]
        upper = min(max(int(np.searchsorted(along, at)), 1), len(way) - 1)
        part = round(float((at - along[upper - 1]) / max(along[upper] - along[upper - 1], 1e-9)), 2)
        low, high = skeleton.joint_names[way[upper - 1]], skeleton.joint_names[way[upper]]
        made[joint] = low if part <= 0 else high if part >= 1 else {low: round(1 - part, 2), high: part}
    return made
