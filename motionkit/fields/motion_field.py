"""The interface of continuous motion: observed frames → a motion field → poses at any times in any order.

Splines, NeRM's latents and PA-HiRes are `MotionEncoder`s that make `MotionField`s; upsampling, completion, evaluation
and export are written once against the two.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Protocol, runtime_checkable

import numpy as np

from motionkit.core import kinematics
from motionkit.core.kinematics import continuous_quaternions
from motionkit.core.motion import Motion, Provenance
from motionkit.core.shapes import Bool, Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid, num_frames_within

TIMES_AT_ONCE = 4096
Times = Float64[np.ndarray, "times"]
"""Seconds, in any order."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses at some instants: positions in metres, and rotations (w, x, y, z) if the field has them.

    Raises `ValueError` for shapes that disagree.
    """

    joint_positions: Float32[np.ndarray, "times joints 3"]
    local_rotations: Float32[np.ndarray, "times joints 4"] | None = None
    root_translation: Float32[np.ndarray, "times 3"] | None = None

    def __post_init__(self) -> None:
        times, joints = self.joint_positions.shape[:2]
        if self.local_rotations is not None and self.local_rotations.shape != (times, joints, 4):
            raise ValueError(f"local_rotations are {self.local_rotations.shape}, expected {(times, joints, 4)}")
        if self.root_translation is not None and self.root_translation.shape != (times, 3):
            raise ValueError(f"root_translation is {self.root_translation.shape}, expected {(times, 3)}")

    @classmethod
    def of(cls, motion: Motion) -> "Poses":
        """All poses of a motion."""
        return cls(motion.joint_positions, motion.local_rotations, motion.root_translation)

    def rows(self, rows: np.ndarray | slice) -> "Poses":
        """Some of the poses, by index, slice or mask."""
        rotations, translation = self.local_rotations, self.root_translation
        return Poses(
            self.joint_positions[rows],
            None if rotations is None else rotations[rows],
            None if translation is None else translation[rows],
        )

    def room_for(self, count: int) -> "Poses":
        """Uninitialised poses with the same fields, `count` of them, to be filled with `put`."""
        return Poses(
            np.empty((count, *self.joint_positions.shape[1:]), np.float32),
            None if self.local_rotations is None else np.empty((count, *self.local_rotations.shape[1:]), np.float32),
            None if self.root_translation is None else np.empty((count, 3), np.float32),
        )

    def put(self, rows: np.ndarray | slice, poses: "Poses") -> None:
        """Writes poses with the same fields into some rows, in place."""
        self.joint_positions[rows] = poses.joint_positions
        if self.local_rotations is not None:
            self.local_rotations[rows] = poses.local_rotations
        if self.root_translation is not None:
            self.root_translation[rows] = poses.root_translation

    def copy(self) -> "Poses":
        """A copy whose arrays may be changed in place."""
        copy = self.room_for(len(self.joint_positions))
        copy.put(slice(None), self)
        return copy

    def at(self, grid: TimeGrid, skeleton: Skeleton, provenance: Provenance | None = None) -> Motion:
        """The poses as a motion on a time grid."""
        return Motion(
            joint_positions=self.joint_positions,
            skeleton=skeleton,
            timegrid=grid,
            local_rotations=self.local_rotations,
            root_translation=self.root_translation,
            provenance=provenance or Provenance(),
        )

    def __repr__(self) -> str:
        times, joints = self.joint_positions.shape[:2]
        has = [name for name in ("local_rotations", "root_translation") if getattr(self, name) is not None]
        return f"Poses({times} of {joints} joints, {', '.join(has) or 'positions only'})"


@dataclass(frozen=True, eq=False)
class Observation:
    """The observed frames of a motion: poses at strictly increasing times (float64 seconds), evenly spaced or not.

    Raises `ValueError` for no pose, shapes that disagree, times that do not increase, and values that are not finite.
    """

    times_seconds: Float64[np.ndarray, "frames"]
    poses: Poses
    skeleton: Skeleton

    def __post_init__(self) -> None:
        expected = (len(self.times_seconds), self.skeleton.num_joints)
        if self.poses.joint_positions.shape[:2] != expected:
            raise ValueError(
                f"poses are {self.poses.joint_positions.shape}, but the times and the skeleton say {expected}"
            )
        if not len(self.times_seconds):
            raise ValueError("nothing is observed: a motion field needs at least one pose")
        late = ~(np.diff(self.times_seconds, prepend=-np.inf) > 0) | ~np.isfinite(self.times_seconds)
        if late.any():
            row = int(np.argmax(late))
            raise ValueError(
                f"times must be finite and increase, unlike {self.times_seconds[row]:.6f} s (row {row}): sort them and "
                "keep one pose of each instant"
            )
        for numbers in (self.poses.joint_positions, self.poses.local_rotations, self.poses.root_translation):
            if numbers is not None and not np.isfinite(numbers).all():
                row = int(np.argmin(np.isfinite(numbers).reshape(len(self), -1).all(axis=1)))
                raise ValueError(
                    f"pose {row} ({self.times_seconds[row]:.4f} s) holds a number that is not finite: leave out poses "
                    "that were not captured, the field fills the gap"
                )

    @classmethod
    def of(cls, motion: Motion, observed: Bool[np.ndarray, "frames"] | None = None) -> "Observation":
        """A motion's frames, or only the `observed` ones.

        Raises `ValueError` for a mask that is not one bool for each frame, and what the constructor raises.
        """
        if observed is not None and (observed.dtype != np.bool_ or observed.shape != (motion.num_frames,)):
            raise ValueError(
                f"observed is a mask of {motion.num_frames} bools, one for each frame, not {observed.dtype} "
                f"{observed.shape}"
            )
        # All frames are the motion's own arrays, not copies of them.
        rows = slice(None) if observed is None or observed.all() else np.flatnonzero(observed)
        return cls(motion.timegrid.seconds()[rows], Poses.of(motion).rows(rows), motion.skeleton)

    def rows(self, rows: np.ndarray | slice) -> "Observation":
        """Some of the poses with their times, by index, slice or mask."""
        return Observation(self.times_seconds[rows], self.poses.rows(rows), self.skeleton)

    @property
    def start_seconds(self) -> float:
        """Time of the first pose."""
        return float(self.times_seconds[0])

    @property
    def end_seconds(self) -> float:
        """Time of the last pose."""
        return float(self.times_seconds[-1])

    def __len__(self) -> int:
        return len(self.times_seconds)

    def __repr__(self) -> str:
        return f"Observation([{self.start_seconds:.4f}, {self.end_seconds:.4f}] s, {self.poses!r}, {self.skeleton!r})"


def continuous_rotations(observation: Observation) -> Observation:
    """The same poses with quaternion signs made continuous in time, if there are rotations."""
    poses = observation.poses
    if poses.local_rotations is None:
        return observation
    return replace(observation, poses=replace(poses, local_rotations=continuous_quaternions(poses.local_rotations)))


@runtime_checkable
class MotionField(Protocol):
    """A motion as a function of time on the closed interval [start_seconds, end_seconds]."""

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of the poses."""

    @property
    def start_seconds(self) -> float:
        """First instant of the domain."""

    @property
    def end_seconds(self) -> float:
        """Last instant of the domain."""

    def query(self, times_seconds: Times) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""


@runtime_checkable
class MotionEncoder(Protocol):
    """Maps observed frames to a motion field: an interpolator, or a trained model."""

    @property
    def name(self) -> str:
        """Name for tables and operation logs."""

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> MotionField:
        """The motion field of an observation; its domain is the observed span, extended as requested.

        Raises `ValueError` if the encoder cannot extrapolate that far.
        """


@runtime_checkable
class BatchEncoder(Protocol):
    """An encoder that can also evaluate a batch of motions that were observed at the same times."""

    def query_many(self, observations: Sequence[Observation], times_seconds: Times) -> list[Poses]:
        """For each motion the poses that its own field, reaching as far as is asked, has at these times.

        Raises `ValueError` for motions that are not observed at the same times or differ in their joints, and where
        the encoder cannot go that far.
        """


@runtime_checkable
class FramerateConditioned(Protocol):
    """A field that also depends on the framerate at which it is sampled (the s of NeRM's Eq. 2)."""

    def at_fps(self, fps: Fraction) -> MotionField:
        """The same motion, conditioned on this framerate."""


@dataclass(frozen=True, eq=False)
class DerivedField:
    """A `MotionField` whose poses are computed from another one's, on the same domain.

    `compute` gives the poses at some times; `derive` derives the same for a framerate (None: it depends on none).
    """

    field: MotionField
    compute: Callable[[Times], Poses]
    derive: Callable[[Fraction], MotionField] | None = None

    @property
    def skeleton(self) -> Skeleton:
        """The other field's skeleton."""
        return self.field.skeleton

    @property
    def start_seconds(self) -> float:
        """First instant of the domain."""
        return self.field.start_seconds

    @property
    def end_seconds(self) -> float:
        """Last instant of the domain."""
        return self.field.end_seconds

    def at_fps(self, fps: Fraction) -> MotionField:
        """Derived from the other field at this framerate."""
        return self if self.derive is None else self.derive(fps)

    def query(self, times_seconds: Times) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        check_times(self, times_seconds)
        return self.compute(times_seconds)


def query_in_blocks(query: Callable[[Times], Poses], times_seconds: Times) -> Poses:
    """`query` for some thousand times at once, so that its intermediate arrays stay in the processor's cache."""
    if len(times_seconds) <= TIMES_AT_ONCE:
        return query(times_seconds)
    blocks = [slice(start, start + TIMES_AT_ONCE) for start in range(0, len(times_seconds), TIMES_AT_ONCE)]
    first = query(times_seconds[blocks[0]])
    result = first.room_for(len(times_seconds))
    result.put(blocks[0], first)
    for block in blocks[1:]:
        result.put(block, query(times_seconds[block]))
    return result


def check_times(field: MotionField, times_seconds: Times) -> None:
    """Raise `ValueError` for times outside the field's domain (a microsecond of rounding is allowed)."""
    inside = (times_seconds >= field.start_seconds - 1e-6) & (times_seconds <= field.end_seconds + 1e-6)
    if not inside.all():
        first = float(times_seconds[np.argmin(inside)])
        raise ValueError(
            f"{int((~inside).sum())} of {times_seconds.size} times lie outside the motion, the first at {first:.4f} s; "
            f"its domain is [{field.start_seconds:.4f}, {field.end_seconds:.4f}] s"
        )


def check_observed_alike(observations: Sequence[Observation]) -> None:
    """Raise `ValueError` unless all motions are observed at the same times and have the same hierarchy."""
    for number, observation in enumerate(observations):
        if not np.array_equal(observation.times_seconds, observations[0].times_seconds):
            raise ValueError(f"motion {number} of {len(observations)} is not observed at the times of the first")
        if observation.skeleton.parents != observations[0].skeleton.parents:
            raise ValueError(f"motion {number} of {len(observations)} has other joints than the first")
    if not observations:
        raise ValueError("no motion is observed")


def at_fps(field: MotionField, fps: Fraction) -> MotionField:
    """The field itself, or where it depends on the framerate that it is sampled at, the one for `fps`."""
    return field.at_fps(fps) if isinstance(field, FramerateConditioned) else field


def to_motion(field: MotionField, fps: Fraction) -> Motion:
    """Sample the whole field uniformly: frame k at start_seconds + k / fps, as far as the domain reaches."""
    num_frames = num_frames_within(field.end_seconds - field.start_seconds, fps)
    grid = TimeGrid(fps, num_frames, field.start_seconds)
    poses = at_fps(field, fps).query(np.minimum(grid.seconds(), field.end_seconds))
    return poses.at(grid, field.skeleton)


@dataclass(frozen=True, eq=False)
class Joints:
    """Local rotations (w, x, y, z), bones in their parent's frame and the root's position, metres, float64.

    Bones are those observed, not the skeleton's rest offsets, so `positions` restores the poses exactly also where the
    rest offsets are not quite the source's, or where rotations come from inverse kinematics.
    """

    rotations: Float64[np.ndarray, "*frames joints 4"]
    bones: Float64[np.ndarray, "*frames joints 3"]
    root: Float64[np.ndarray, "*frames 3"]

    @classmethod
    def of(cls, poses: Poses, skeleton: Skeleton) -> "Joints":
        """Decomposes poses; those without rotations, in chronological order, get them from inverse kinematics."""
        local = poses.local_rotations
        if local is None:
            local = kinematics.inverse_kinematics_in_time(poses.joint_positions, skeleton)
        rotations = local.astype(np.float64)
        positions = poses.joint_positions.astype(np.float64)
        parents = list(skeleton.parents[1:])
        world = kinematics.global_rotations(rotations, skeleton)
        bones = np.zeros_like(positions)
        bones[:, 1:] = kinematics.quaternion_rotate(
            kinematics.quaternion_conjugate(world[:, parents]), positions[:, 1:] - positions[:, parents]
        )
        return cls(rotations, bones, positions[:, 0])

    @classmethod
    def stacked(cls, each: "Sequence[Joints]") -> "Joints":
        """Several motions of as many frames along a second axis, so that one curve goes through all of them."""
        return cls(
            np.stack([joints.rotations for joints in each], axis=1),
            np.stack([joints.bones for joints in each], axis=1),
            np.stack([joints.root for joints in each], axis=1),
        )

    def positions(self, skeleton: Skeleton) -> Float32[np.ndarray, "*frames joints 3"]:
        """Forward kinematics, metres."""
        joints = skeleton.num_joints
        rotations, bones = self.rotations.reshape(-1, joints, 4), self.bones.reshape(-1, joints, 3)
        positions = kinematics.forward_kinematics(rotations, self.root.reshape(-1, 3), skeleton, bones)
        return positions.astype(np.float32).reshape(self.bones.shape)


def with_rotations(observation: Observation) -> Observation:
    """The observation itself if its poses have rotations, else with those of inverse kinematics in time."""
    poses = observation.poses
    if poses.local_rotations is not None:
        return observation
    rotations = kinematics.inverse_kinematics_in_time(poses.joint_positions, observation.skeleton).astype(np.float32)
    return replace(observation, poses=replace(poses, local_rotations=rotations))


def turned_rotations(
    rotations: Float32[np.ndarray, "times joints 4"],
    turned: dict[int, Float64[np.ndarray, "times 4"]],
    skeleton: Skeleton,
) -> Float32[np.ndarray, "times joints 4"]:
    """Local rotations of joints that `turned` in the world, and of their children that did not."""
    result = rotations.copy()
    world = kinematics.global_rotations(rotations.astype(np.float64), skeleton)
    for joint, parent in enumerate(skeleton.parents):
        if joint not in turned and parent not in turned:
            continue
        local = world[:, joint]
        if joint in turned:
            local = kinematics.quaternion_multiply(turned[joint], local)
        if parent >= 0:
            above = world[:, parent]
            if parent in turned:
                above = kinematics.quaternion_multiply(turned[parent], above)
            local = kinematics.quaternion_multiply(kinematics.quaternion_conjugate(above), local)
        result[:, joint] = local / np.linalg.norm(local, axis=-1, keepdims=True)
    return result
