"""Constraints on generated motions: a path on the floor, poses, joints at given instants.

Models declare the kinds that they support (`motionkit.generate.models.FollowsConstraints`).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Float64
from motionkit.core.skeleton import SMPL22
from motionkit.features.field import heading as heading_of
from motionkit.features.field import to_window
from motionkit.fields.motion_field import MotionField

ConstraintKind = Literal["path", "pose", "joint"]
ConstraintFrame = Literal["world", "body"]
Number = int | float
KINDS: frozenset[ConstraintKind] = frozenset(("path", "pose", "joint"))

PATH_INSTANTS_PER_SECOND = 8.0
JOINT_INSTANTS_PER_SECOND = 24.0
PATH_DEVIATION, JOINT_DEVIATION = 0.03, 0.005
ROOT = SMPL22.joint_names[0]


@dataclass(frozen=True, eq=False)
class Constraint:
    """Target positions of joints of the 22-joint layout at some instants of a motion, metres; NaN leaves a number free.

    In the frame `world` positions are in world coordinates; a motion without such constraints begins at the origin,
    facing Z+. In the frame `body` they are relative to the point of the floor under the root, facing Z+, so that a pose
    may be anywhere. `heading` is the facing direction in the world (radians, 0 is Z+, positive towards X+).
    `deviation` is the tolerance as a standard deviation in metres. Raises `UsageError` for inconsistent arrays, unknown
    joints and instants before 0.

    >>> turn = mk.Constraint.path([(0, 0), (0, 3), (3, 3)], seconds=[0, 2.5, 5])
    >>> model = mk.load_model("runs/nano").constrained(turn)
    >>> model.generate("a person walks", fps=30, seconds=5).num_frames
    150
    """

    kind: ConstraintKind
    name: str
    seconds: Float64[np.ndarray, "instants"]
    joints: tuple[str, ...]
    positions: Float64[np.ndarray, "instants joints 3"]
    heading: Float64[np.ndarray, "instants"]
    frame: ConstraintFrame
    deviation: float = field(default=JOINT_DEVIATION, kw_only=True)

    def __post_init__(self) -> None:
        unknown = [joint for joint in self.joints if joint not in SMPL22.joint_names]
        if unknown:
            raise UsageError(
                f"{self.name}: no joint is called {unknown[0]!r}; there are {', '.join(SMPL22.joint_names)}"
            )
        instants = len(self.seconds)
        if self.positions.shape != (instants, len(self.joints), 3) or self.heading.shape != (instants,):
            raise UsageError(f"{self.name}: {instants} instants, but positions {self.positions.shape}")
        if not instants or not np.isfinite(self.seconds).all() or self.seconds.min() < 0:
            raise UsageError(f"{self.name}: instants are seconds from 0 on, and at least one")
        if np.isinf(self.positions).any() or np.isinf(self.heading).any():
            raise UsageError(f"{self.name}: a position is infinite")

    @classmethod
    def path(
        cls,
        places: "Sequence[tuple[Number, Number]] | Float[np.ndarray, 'points 2']",
        seconds: "Sequence[Number] | Float[np.ndarray, 'points']",
        heading: "Sequence[Number] | Float[np.ndarray, 'points'] | None" = None,
        name: str = "path",
    ) -> "Constraint":
        """The root at (x, z) at ascending seconds, interpolated without overshoot (PCHIP).

        `heading` is the facing direction (radians). Raises `UsageError` for fewer than two points, and for seconds that
        don't ascend.
        """
        from scipy.interpolate import PchipInterpolator

        times, points = np.asarray(seconds, np.float64), np.asarray(places, np.float64).reshape(-1, 2)
        if len(points) < 2 or len(times) != len(points) or not (np.diff(times) > 0).all():
            raise UsageError(f"{name}: a path has two points or more, at seconds that ascend")
        count = max(2, int(np.ceil((times[-1] - times[0]) * PATH_INSTANTS_PER_SECOND)) + 1)
        instants = np.linspace(times[0], times[-1], count)
        positions = np.full((count, 1, 3), np.nan)
        positions[:, 0, [0, 2]] = PchipInterpolator(times, points)(instants)
        facing = np.full(count, np.nan)
        if heading is not None:
            facing = PchipInterpolator(times, np.unwrap(np.asarray(heading, np.float64)))(instants)
        return cls("path", name, instants, (ROOT,), positions, facing, "world", deviation=PATH_DEVIATION)

    @classmethod
    def pose(
        cls,
        joint_positions: Float[np.ndarray, "22 3"],
        seconds: Number,
        *,
        joints: Sequence[str] = SMPL22.joint_names,
        placed: bool = False,
        name: str = "pose",
    ) -> "Constraint":
        """A pose of the 22-joint layout at an instant, optionally only some joints; heights are the world's.

        Its position and heading on the floor are free, unless `placed`.
        """
        pose = np.asarray(joint_positions, np.float64)[None]
        if not placed:
            pose = in_body_frame(pose)
        rows = [SMPL22.joint_names.index(joint) for joint in joints if joint in SMPL22.joint_names]
        given = pose[:, rows] if len(rows) == len(joints) else np.zeros((1, len(joints), 3))
        nowhere = np.full(1, np.nan)
        return cls(
            "pose", name, np.array([seconds], np.float64), tuple(joints), given, nowhere, "world" if placed else "body"
        )

    @classmethod
    def joint(
        cls, joint: str, place: tuple[Number, Number, Number], start: Number, end: Number | None = None, name: str = ""
    ) -> "Constraint":
        """A joint at a world position (x, y, z), at an instant or from `start` to `end`."""
        end = start if end is None else end
        count = 1 + max(0, int(np.ceil((end - start) * JOINT_INSTANTS_PER_SECOND)))
        positions = np.tile(np.asarray(place, np.float64), (count, 1, 1))
        nowhere = np.full(count, np.nan)
        return cls("joint", name or joint, np.linspace(start, end, count), (joint,), positions, nowhere, "world")

    @property
    def places_motion(self) -> bool:
        """Whether it determines the motion's place in the world."""
        return self.frame == "world" and self.kind != "joint"

    @property
    def joint_indices(self) -> list[int]:
        """Its joints in the 22-joint layout."""
        return [SMPL22.joint_names.index(joint) for joint in self.joints]

    def between(self, start_seconds: float, end_seconds: float) -> "Constraint | None":
        """The constraint on an interval of the motion, in the interval's own time; None if it does not apply."""
        inside = (self.seconds >= start_seconds - 1e-9) & (self.seconds <= end_seconds + 1e-9)
        if not inside.any():
            return None
        seconds = np.clip(self.seconds[inside] - start_seconds, 0.0, end_seconds - start_seconds)
        return replace(self, seconds=seconds, positions=self.positions[inside], heading=self.heading[inside])

    def plain(self) -> dict[str, Any]:
        """Its identity as JSON: kind, name and checksum."""
        digest = hashlib.sha256(repr((self.frame, self.joints, self.deviation)).encode())
        for array in (self.positions, self.heading, self.seconds):
            digest.update((array.round(9) + 0.0).tobytes())  # + 0.0: the same bytes for 0 and −0
        return {"kind": self.kind, "name": self.name, "sha256": digest.hexdigest()}

    def later(self, seconds: float) -> "Constraint":
        """The same, delayed by some seconds."""
        return replace(self, seconds=self.seconds + seconds)


@dataclass(frozen=True)
class Followed:
    """Errors of a motion under a constraint: distances over joints and instants, and of headings if constrained."""

    kind: ConstraintKind
    name: str
    mean_metres: float
    max_metres: float
    mean_degrees: float | None = None


def followed(motion: MotionField, constraint: Constraint) -> Followed:
    """Measure how well a motion in the 22-joint layout meets a constraint."""
    seconds = np.clip(constraint.seconds, motion.start_seconds, motion.end_seconds)
    joints = motion.query(seconds).joint_positions[:, : SMPL22.num_joints].astype(np.float64)
    here = joints if constraint.frame == "world" else in_body_frame(joints)
    apart = here[:, constraint.joint_indices] - constraint.positions
    known = ~np.isnan(apart).all(axis=-1)
    distances = np.sqrt(np.nansum(np.square(apart), axis=-1))[known]
    turned = heading_of(joints) - constraint.heading
    degrees = np.abs(np.degrees(np.arctan2(np.sin(turned), np.cos(turned))))
    faces = None if np.isnan(degrees).all() else float(np.nanmean(degrees))
    distances = distances if len(distances) else np.zeros(1)
    return Followed(constraint.kind, constraint.name, float(distances.mean()), float(distances.max()), faces)


def in_body_frame(joint_positions: Float[np.ndarray, "poses 22 3"]) -> Float64[np.ndarray, "poses 22 3"]:
    """Each pose seen from the floor under its root, ahead being Z+."""
    yaw = heading_of(joint_positions)
    return to_window(joint_positions[:, None], yaw, joint_positions[:, 0, (0, 2)])[:, 0].astype(np.float64)
