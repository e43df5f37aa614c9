"""ASF: the skeleton of AMC motions (Acclaim). Bones with a rest direction, a length and an axis frame.

Source: http://research.cs.wisc.edu/graphics/Courses/cs-838-1999/Jeff/ASF-AMC.html.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from motionkit.core import kinematics
from motionkit.core.errors import FormatError
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import MAX_JOINTS, Skeleton
from motionkit.io import source_file
from motionkit.io.number_table import parse_number

ROTATIONS = {"rx": "X", "ry": "Y", "rz": "Z"}
INCH = 0.0254
LONGEST_MESSAGE = 400


@dataclass
class AsfBone:
    """One bone, or the root (its `dof` is the channel order): rest direction, length in file units, axis frame."""

    name: str
    direction: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axis_angles: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis_order: str = "XYZ"
    dof: tuple[str, ...] = ()


@dataclass(frozen=True)
class AsfSkeleton:
    """The root and all bones, parents first, with parent indices; `degrees`: angles are in degrees.

    `skeleton` has a joint at the start of every bone, with the bone's name: lfemur is the hip. Its offsets are in
    metres, and a leaf bone's end is an End Site.
    """

    bones: tuple[AsfBone, ...]
    skeleton: Skeleton
    unit_metres: float
    degrees: bool
    root_position: Float64[np.ndarray, "3"]

    @cached_property
    def axis_frames(self) -> Float64[np.ndarray, "bones 4"]:
        """C of every bone as a quaternion; the axis angles are about fixed axes, in the order listed."""
        scale = np.pi / 180.0 if self.degrees else 1.0
        return np.stack(
            [
                kinematics.euler_to_quaternion(np.array(bone.axis_angles) * scale, bone.axis_order, kind="extrinsic")
                for bone in self.bones
            ]
        )


def read_asf(path: Path, unit_metres: float | None = None) -> AsfSkeleton:
    """Read a skeleton; metres per unit are 0.0254 / length unit unless given.

    Raises `FormatError` (`asf`, `not-what-it-says`, …) naming the line.
    """
    return _parsed(source_file.read_bytes(path), path, unit_metres)


# All takes of a subject share one file.
@lru_cache(maxsize=8)
def _parsed(data: bytes, path: Path, unit_metres: float | None) -> AsfSkeleton:
    parser = _Parser(path)
    if not re.search(rb"(?m)^[ \t]*:(bonedata|root)\b", data):
        raise FormatError(
            f"looks like {source_file.describe_content(data)}, expected an ASF skeleton with :root and :bonedata",
            path=path,
            reason="not-what-it-says",
        )
    for parser.line, line in enumerate(source_file.decode(data, path).splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if words:
            parser.feed(words)
    return parser.finish(unit_metres)


class _Parser:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.line = 0
        self.section = ""
        self.length_unit = 1.0
        self.degrees = True
        self.root = AsfBone("root", dof=("tx", "ty", "tz", "rx", "ry", "rz"))
        self.root_position = np.zeros(3)
        self.bones: dict[str, AsfBone] = {}
        self.bone: AsfBone | None = None
        self.parents: dict[str, str] = {}

    def fault(self, message: str) -> FormatError:
        """An error at the current line."""
        return FormatError(message, path=self.path, reason="asf", line=self.line)

    def numbers(self, words: list[str], count: int) -> list[float]:
        """Exactly `count` numbers at the beginning of `words`."""
        if len(words) < count:
            raise self.fault(f"{len(words)} numbers, expected {count}")
        return [parse_number(word, self.path, self.line) for word in words[:count]]

    def feed(self, words: list[str]) -> None:
        """Parse one line without its comment."""
        if words[0].startswith(":"):
            self.section = words[0][1:].lower()
            return
        match self.section:
            case "units":
                self.units(words)
            case "root":
                self.root_entry(words)
            case "bonedata":
                self.bone_entry(words)
            case "hierarchy":
                self.hierarchy(words)

    def units(self, words: list[str]) -> None:
        """Length unit and angle unit."""
        if words[0] == "length":
            self.length_unit = self.numbers(words[1:], 1)[0]
            if not self.length_unit > 0:
                raise self.fault(f"length unit {self.length_unit}, expected a positive number")
        elif words[0] == "angle":
            if words[1:] not in (["deg"], ["rad"]):
                raise self.fault(f"angle {' '.join(words[1:])!r}, expected deg or rad")
            self.degrees = words[1] == "deg"

    def root_entry(self, words: list[str]) -> None:
        """Order of channels, axis frame and rest position of the root."""
        match words[0].lower():
            case "order":
                self.root.dof = tuple(word.lower() for word in words[1:])
            case "axis":
                self.root.axis_order = self.order(words[1:])
            case "position":
                self.root_position = np.array(self.numbers(words[1:], 3))
            case "orientation":
                x, y, z = self.numbers(words[1:], 3)
                self.root.axis_angles = (x, y, z)

    def bone_entry(self, words: list[str]) -> None:
        """One line of a begin … end block."""
        keyword = words[0].lower()
        if keyword == "begin":
            self.bone = AsfBone("")
            return
        if self.bone is None:
            raise self.fault(f"{words[0]!r} outside begin … end")
        match keyword:
            case "end":
                if not self.bone.name or self.bone.name in self.bones or self.bone.name == "root":
                    raise self.fault(f"bone name {self.bone.name!r} is missing or repeated")
                if len(self.bones) >= MAX_JOINTS - 1:
                    raise self.fault(f"more than {MAX_JOINTS:,} bones")
                self.bones[self.bone.name] = self.bone
                self.bone = None
            case "name":
                self.bone.name = " ".join(words[1:])
            case "direction":
                direction = np.array(self.numbers(words[1:], 3))
                norm = float(np.linalg.norm(direction))
                self.bone.direction = direction / norm if norm > 0 else direction
            case "length":
                self.bone.length = self.numbers(words[1:], 1)[0]
            case "axis":
                x, y, z = self.numbers(words[1:], 3)
                self.bone.axis_angles, self.bone.axis_order = (x, y, z), self.order(words[4:])
            case "dof":
                self.bone.dof = tuple(word.lower() for word in words[1:])
                unknown = [word for word in self.bone.dof if word not in ROTATIONS]
                if unknown:
                    raise self.fault(f"degrees of freedom {', '.join(unknown)}, expected rx, ry, rz")

    def order(self, words: list[str]) -> str:
        """An order of axes such as XYZ."""
        order = "".join(words).upper() or "XYZ"
        if sorted(order) != ["X", "Y", "Z"]:
            raise self.fault(f"axis order {order!r}, expected a permutation of XYZ")
        return order

    def hierarchy(self, words: list[str]) -> None:
        """A parent followed by its children."""
        if words[0] in ("begin", "end"):
            return
        for child in words[1:]:
            if child in self.parents or child not in self.bones:
                raise self.fault(f"bone {child!r} is unknown or has two parents")
            self.parents[child] = words[0]

    def finish(self, unit_metres: float | None) -> AsfSkeleton:
        """Order bones parents first and build the joints."""
        if self.bone is not None or not self.bones:
            raise self.fault("the bone data ends early, expected begin … end blocks")
        unknown = [word for word in self.root.dof if word not in (*ROTATIONS, "tx", "ty", "tz")]
        if unknown or len(set(self.root.dof)) != len(self.root.dof):
            raise self.fault(f"root order {' '.join(self.root.dof)!r}, expected TX TY TZ RX RY RZ in some order")
        names = _depth_first(self.bones, self.parents)
        lost = sorted(set(self.bones) - set(names))
        if lost:
            raise self.fault(f"bones not connected to the root in :hierarchy: {', '.join(lost)}"[:LONGEST_MESSAGE])
        bones = tuple(self.root if name == "root" else self.bones[name] for name in names)
        metres = unit_metres or INCH / self.length_unit
        return AsfSkeleton(
            bones=bones,
            skeleton=_joints(self.path.stem, bones, [self.parents.get(name, "") for name in names], metres),
            unit_metres=metres,
            degrees=self.degrees,
            root_position=self.root_position,
        )


def _depth_first(bones: Iterable[str], parents: Mapping[str, str]) -> list[str]:
    # The root and all bones below it, parents first.
    children: dict[str, list[str]] = {}
    for name in bones:
        if name in parents:
            children.setdefault(parents[name], []).append(name)
    ordered, stack = [], ["root"]
    while stack:
        name = stack.pop()
        ordered.append(name)
        stack += reversed(children.get(name, []))
    return ordered


def _joints(name: str, bones: tuple[AsfBone, ...], parents: list[str], metres: float) -> Skeleton:
    names = [bone.name for bone in bones]
    place = {name: index for index, name in enumerate(names)}
    indices = [place[parent] if parent else -1 for parent in parents]
    above = set(indices)
    ends = np.stack([bone.direction * bone.length * metres for bone in bones])
    offsets = np.stack([ends[parent] if parent >= 0 else np.zeros(3) for parent in indices])
    leaves = [joint for joint in range(len(bones)) if joint not in above and ends[joint].any()]
    return Skeleton(
        name=name,
        joint_names=tuple(names),
        parents=tuple(indices),
        offsets=offsets.astype(np.float32),
        end_sites=tuple(
            (joint, (float(ends[joint, 0]), float(ends[joint, 1]), float(ends[joint, 2]))) for joint in leaves
        ),
    )
