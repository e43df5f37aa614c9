"""Skeletons: joint names, parents, rest offsets, left/right pairs, feet; and the standard ones."""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from motionkit.core.shapes import Float32, Int64

# More joints in a file are a mistake or an attack.
MAX_JOINTS = 10_000


@dataclass(frozen=True)
class Feet:
    """Joint indices of both feet; `toe` equals `ankle` for a skeleton without toe joints."""

    left_ankle: int
    left_toe: int
    right_ankle: int
    right_toe: int


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A joint hierarchy, parents before children.

    `offsets` are rest positions relative to the parent in metres, float32 [J, 3] (row 0: the root's rest offset).
    `end_sites` maps a leaf's index to the offset of the unnamed tip that BVH calls End Site. `layout_map` is a user's
    map to the standard layouts as canonical JSON (`motionkit.core.skeletons.mapping`), or empty to map by names.
    Raises `ValueError` for a parent that does not precede its child, repeated names, or arrays of unequal length.

    >>> skeleton = mk.read("walk.bvh").skeleton
    >>> skeleton.num_joints, skeleton.joint_names[0], skeleton.parents[:3]
    (22, 'pelvis', (-1, 0, 1))
    """

    name: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Float32[np.ndarray, "joints 3"]
    left_right_pairs: tuple[tuple[int, int], ...] = ()
    feet: Feet | None = None
    end_sites: tuple[tuple[int, tuple[float, float, float]], ...] = ()
    layout_map: str = ""

    def __post_init__(self) -> None:
        if not len(self.joint_names) == len(self.parents) == len(self.offsets):
            raise ValueError(
                f"skeleton {self.name!r} has {len(self.joint_names)} names, {len(self.parents)} parents and "
                f"{len(self.offsets)} offsets; the three must agree"
            )
        if len(set(self.joint_names)) != len(self.joint_names):
            raise ValueError(f"skeleton {self.name!r} repeats a joint name")
        if self.parents[0] != -1 or any(not 0 <= parent < child for child, parent in enumerate(self.parents) if child):
            raise ValueError(f"skeleton {self.name!r}: joint 0 must be the only root and parents must precede children")

    @property
    def num_joints(self) -> int:
        """Number of joints J."""
        return len(self.joint_names)

    @cached_property
    def parents_or_self(self) -> Int64[np.ndarray, "joints"]:
        """Each joint's parent; the root's is the root."""
        return np.maximum(self.parents, 0)

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 over everything but the name: equal for equal skeletons."""
        digest = hashlib.sha256()
        digest.update(repr((self.joint_names, self.parents, self.left_right_pairs, self.feet, self.end_sites)).encode())
        digest.update(np.ascontiguousarray(self.offsets, dtype="<f4").tobytes())
        digest.update(self.layout_map.encode())
        return digest.hexdigest()[:16]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Skeleton) and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def __repr__(self) -> str:
        return f"Skeleton({self.name!r}, {self.num_joints} joints, {self.fingerprint})"

    def index(self, joint_name: str) -> int:
        """Index of a joint by name; raises `KeyError` that lists the names."""
        try:
            return self.joint_names.index(joint_name)
        except ValueError:
            raise KeyError(
                f"skeleton {self.name!r} has no joint {joint_name!r}: {', '.join(self.joint_names)}"
            ) from None

    def scaled(self, factor: float) -> "Skeleton":
        """The same skeleton with all lengths multiplied."""
        return replace(
            self,
            offsets=self.offsets * np.float32(factor),
            end_sites=tuple((joint, (x * factor, y * factor, z * factor)) for joint, (x, y, z) in self.end_sites),
        )

    def children(self, joint: int) -> tuple[int, ...]:
        """Indices of a joint's children."""
        return self._children[joint]

    @cached_property
    def _children(self) -> tuple[tuple[int, ...], ...]:
        children: list[list[int]] = [[] for _ in self.parents]
        for child, parent in enumerate(self.parents):
            if parent >= 0:
                children[parent].append(child)
        return tuple(map(tuple, children))

    def path_to_root(self, joint: int) -> tuple[int, ...]:
        """A joint, its parent, and so on up to the root."""
        path = [joint]
        while self.parents[path[-1]] >= 0:
            path.append(self.parents[path[-1]])
        return tuple(path)

    def subtree(self, joint: int) -> list[int]:
        """A joint and all joints below it."""
        return [each for each in range(self.num_joints) if joint in self.path_to_root(each)]


def _standard(
    name: str,
    joints: tuple[tuple[str, int, tuple[float, float, float]], ...],
    pairs: tuple[tuple[int, int], ...],
    feet: Feet,
) -> Skeleton:
    names, parents, offsets = zip(*joints, strict=True)
    return Skeleton(name, names, parents, np.array(offsets, dtype=np.float32), pairs, feet)


# Directions are HumanML3D's raw bone directions; lengths are those of its uniform skeleton (target clip 000021), in
# metres: means over the frames of the published clip 012314, in which they spread by at most 2e-6.
SMPL22 = _standard(
    "smpl22",
    (
        ("pelvis", -1, (0.0, 0.0, 0.0)),
        ("left_hip", 0, (0.1030740, 0.0, 0.0)),
        ("right_hip", 0, (-0.1098834, 0.0, 0.0)),
        ("spine1", 0, (0.0, 0.1315682, 0.0)),
        ("left_knee", 1, (0.0, -0.3936232, 0.0)),
        ("right_knee", 2, (0.0, -0.3901882, 0.0)),
        ("spine2", 3, (0.0, 0.1431902, 0.0)),
        ("left_ankle", 4, (0.0, -0.4324330, 0.0)),
        ("right_ankle", 5, (0.0, -0.4256434, 0.0)),
        ("spine3", 6, (0.0, 0.0573647, 0.0)),
        ("left_foot", 7, (0.0, 0.0, 0.1433818)),
        ("right_foot", 8, (0.0, 0.0, 0.1494191)),
        ("neck", 9, (0.0, 0.2193600, 0.0)),
        ("left_collar", 9, (0.1374868, 0.0, 0.0)),
        ("right_collar", 9, (-0.1433828, 0.0, 0.0)),
        ("head", 12, (0.0, 0.0, 0.1030392)),
        ("left_shoulder", 13, (0.0, -0.1316140, 0.0)),
        ("right_shoulder", 14, (0.0, -0.1229844, 0.0)),
        ("left_elbow", 16, (0.0, -0.2568399, 0.0)),
        ("right_elbow", 17, (0.0, -0.2630919, 0.0)),
        ("left_wrist", 18, (0.0, -0.2660118, 0.0)),
        ("right_wrist", 19, (0.0, -0.2698763, 0.0)),
    ),
    pairs=((1, 2), (4, 5), (7, 8), (10, 11), (13, 14), (16, 17), (18, 19), (20, 21)),
    feet=Feet(left_ankle=7, left_toe=10, right_ankle=8, right_toe=11),
)

# The Master Motor Map joints of KIT-ML in HumanML3D's order and with its sides (right leg 11–15, left leg 16–20), as
# fractions of body height: the published files are in the unit of a body of height 1.
KIT21 = _standard(
    "kit21",
    (
        ("root", -1, (0.0, 0.0, 0.0)),
        ("BP", 0, (0.0, 0.04, 0.0)),
        ("BT", 1, (0.0, 0.06, 0.0)),
        ("BLN", 2, (0.0, 0.188, 0.0)),
        ("BUN", 3, (0.0, 0.03, 0.0)),
        ("RS", 3, (0.11, 0.0, 0.0)),
        ("RE", 5, (0.0, -0.188, 0.0)),
        ("RW", 6, (0.0, -0.145, 0.0)),
        ("LS", 3, (-0.11, 0.0, 0.0)),
        ("LE", 8, (0.0, -0.188, 0.0)),
        ("LW", 9, (0.0, -0.145, 0.0)),
        ("RH", 0, (0.052, 0.0, 0.0)),
        ("RK", 11, (0.0, -0.245, 0.0)),
        ("RA", 12, (0.0, -0.246, 0.0)),
        ("RMrot", 13, (0.0, 0.0, 0.06)),
        ("RF", 14, (0.0, 0.0, 0.04)),
        ("LH", 0, (-0.052, 0.0, 0.0)),
        ("LK", 16, (0.0, -0.245, 0.0)),
        ("LA", 17, (0.0, -0.246, 0.0)),
        ("LMrot", 18, (0.0, 0.0, 0.06)),
        ("LF", 19, (0.0, 0.0, 0.04)),
    ),
    pairs=((8, 5), (9, 6), (10, 7), (16, 11), (17, 12), (18, 13), (19, 14), (20, 15)),
    feet=Feet(left_ankle=19, left_toe=20, right_ankle=14, right_toe=15),
)

STANDARD_SKELETONS: dict[str, Skeleton] = {skeleton.name: skeleton for skeleton in (SMPL22, KIT21)}
