"""Motion with planted feet: a motion field that wraps another, and the same for a motion's own frames."""

from dataclasses import dataclass, replace

import numpy as np

from motionkit.core.kinematics import quaternion_rotate
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.contact.bones import Bones
from motionkit.fields.contact.correction import Correction, Path, find_correction
from motionkit.fields.contact.detection import EndMask
from motionkit.fields.contact.legs import Leg, Legs, bend, legs_of, turns
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.joints import turned_rotations
from motionkit.fields.motion_field import (
    DerivedField,
    MotionField,
    Observation,
    Poses,
    Times,
    at_fps,
    contacts_of,
    query_in_blocks,
)

GRID_FPS = 120.0
BONE_SAMPLES = 512
_UP = np.array([0.0, 1.0, 0.0])
_SMALL_METRES = 1e-7
PROBABLY = 0.5


@dataclass(frozen=True, eq=False)
class Planting:
    """The poses of a field with planted feet and constant bone lengths, at any times in any order.

    The correction is computed once, on a 120 Hz grid of the field, and is a function of time with continuous velocity:
    every second frame at 60 fps is a frame at 30.
    """

    field: MotionField
    legs: Legs
    bones: Bones | None
    correction: Correction

    def __call__(self, times_seconds: Times) -> Poses:
        """The poses at some times inside the field's domain."""
        return query_in_blocks(self._poses, times_seconds)

    def _poses(self, times: Times) -> Poses:
        poses = self.field.query(times)
        if self.bones is not None:
            poses = Poses(self.bones.applied(poses.joint_positions), None, poses.root_translation)
        return with_offsets(poses, self.correction.at(times), self.legs, self.field.skeleton)

    def derived(self) -> DerivedField:
        """The planted field; contacts don't depend on the framerate, so the correction is that of every one."""
        return DerivedField(self.field, self, lambda fps: replace(self, field=at_fps(self.field, fps)).derived())


def planted(field: MotionField, path: Path = "near") -> DerivedField:
    """A field with planted feet; positions without rotations are projected onto constant bone lengths first.

    With a `free` path the body goes where its planted feet carry it, and may end elsewhere: for generated motion.
    Contacts are those that the field predicts (`PredictsContacts`), else they are detected at 120 Hz or slightly more,
    so that the last sample is the field's end. Raises `SkeletonMapError` for a skeleton whose legs aren't known.
    """
    span = field.end_seconds - field.start_seconds
    count = int(np.ceil(span * GRID_FPS - 1e-6)) + 1
    fps = (count - 1) / span if count > 1 else GRID_FPS
    times = np.minimum(field.start_seconds + np.arange(count) / fps, field.end_seconds)
    probability = contacts_of(field, times)
    predicted = None if probability is None else np.asarray(probability > PROBABLY)
    return _planting(field, field.query(times), fps, path, predicted).derived()


def planted_frames(observation: Observation, frames: TimeGrid, path: Path = "near") -> Planting:
    """A motion's frames with planted feet, defined at the frames' own times only.

    At very high framerates only every second frame, or third, is used for detection.
    """
    step = max(1, round(float(frames.fps) / GRID_FPS))
    field = INTERPOLATORS["hold"].encode(observation)
    return _planting(field, observation.poses.rows(slice(None, None, step)), float(frames.fps / step), path)


def _planting(field: MotionField, poses: Poses, fps: float, path: Path, predicted: EndMask | None = None) -> Planting:
    """The planting of a field by its poses at the samples of a grid."""
    legs, bones, positions = legs_of(field.skeleton), None, poses.joint_positions
    if poses.local_rotations is None:
        some = np.unique(np.linspace(0, len(positions) - 1, min(len(positions), BONE_SAMPLES)).astype(np.int64))
        bones = Bones.lacking(positions[some], field.skeleton, captured=path == "near")
        if bones is not None:
            positions = bones.applied(positions, legs.feet)
    paths = legs.foot_paths(positions).astype(np.float64)
    return Planting(field, legs, bones, find_correction(paths, field.start_seconds, fps, path, predicted))


def with_offsets(poses: Poses, offsets: Float64[np.ndarray, "times 3 3"], legs: Legs, skeleton: Skeleton) -> Poses:
    """Applies offsets of body and feet, bending the legs; poses with zero offsets are unchanged."""
    rows = np.flatnonzero(np.abs(offsets).max(axis=(1, 2)) > _SMALL_METRES)
    if not len(rows):
        return poses
    some = poses.rows(rows)
    moved = _moved(some, offsets[rows], legs, skeleton)
    if len(rows) == len(offsets):
        return moved
    result = poses.copy()
    result.put(rows, moved)
    return result


def _moved(poses: Poses, offsets: Float64[np.ndarray, "times 3 3"], legs: Legs, skeleton: Skeleton) -> Poses:
    positions = poses.joint_positions + offsets[:, :1].astype(np.float32)
    ends = {joint: positions[:, joint].astype(np.float64) for leg in (legs.left, legs.right) for joint in _chain(leg)}
    forward = np.cross(ends[legs.left.hip] - ends[legs.right.hip], _UP)
    forward /= np.maximum(np.linalg.norm(forward, axis=-1, keepdims=True), 1e-9)
    rotations = poses.local_rotations
    turned: dict[int, Float64[np.ndarray, "times 4"]] = {}
    for foot, leg in enumerate((legs.left, legs.right)):
        hip, knee, ankle = (ends[joint] for joint in _chain(leg))
        new_knee, new_ankle = bend(hip, knee, ankle, ankle + offsets[:, 1 + foot], forward)
        step = (new_ankle - ankle).astype(np.float32)
        for joint in (leg.ankle, *leg.foot):
            positions[:, joint] += step
        inner = [joint for joint in (*leg.thigh, *leg.shank) if joint not in (leg.knee, leg.ankle)]
        if rotations is not None or inner:
            thigh, shank = turns(hip, knee, ankle, new_knee, new_ankle)
            # Twist joints, pads and end sites move along with the thigh and the shank.
            for joint in inner:
                old, new, turn = (hip, hip, thigh) if joint in leg.thigh else (knee, new_knee, shank)
                positions[:, joint] = new + quaternion_rotate(turn, positions[:, joint] - old)
            turned |= dict.fromkeys((leg.hip, *(set(leg.thigh) - {leg.knee})), thigh)
            turned |= dict.fromkeys((leg.knee, *(set(leg.shank) - {leg.ankle})), shank)
        positions[:, leg.knee] = new_knee
    translation = poses.root_translation
    if translation is not None:
        translation = translation + offsets[:, 0].astype(np.float32)
    if rotations is not None:
        rotations = turned_rotations(rotations, turned, skeleton)
    return Poses(positions, rotations, translation)


def _chain(leg: Leg) -> tuple[int, int, int]:
    return leg.hip, leg.knee, leg.ankle
