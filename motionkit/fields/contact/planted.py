"""Motion whose feet stand: a motion field on a motion field, and the same for a motion's own frames."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from motionkit.core.kinematics import quaternion_conjugate, quaternion_multiply, quaternion_rotate
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.contact.bones import Bones
from motionkit.fields.contact.correction import Correction, Path
from motionkit.fields.contact.known import contacts_of
from motionkit.fields.contact.legs import Leg, Legs, legs_of
from motionkit.fields.contact.two_bone import BentLeg, bend, turns
from motionkit.fields.interpolation.interpolators import INTERPOLATORS
from motionkit.fields.motion_field import MotionField, Observed, Poses, at_fps, check_times

GRID_FPS = 120.0
BONE_SAMPLES = 1000
TIMES_AT_ONCE = 4096
_UP = np.array([0.0, 1.0, 0.0])
_SMALL_METRES = 1e-7
PROBABLY = 0.5


@dataclass(frozen=True, eq=False)
class PlantedField:
    """A `MotionField` on another one: its poses with feet that stand, on bones of one length.

    What is changed is found once, on a grid of 120 instants a second of the field below, and is a function of time with
    continuous velocity: so any instants can be asked for, in any order, and every second frame of 60 fps is a frame of
    30. Memory doesn't grow with the motion.
    """

    field: MotionField
    legs: Legs
    bones: Bones | None
    correction: Correction

    @property
    def skeleton(self) -> Skeleton:
        """The field's."""
        return self.field.skeleton

    @property
    def start_seconds(self) -> float:
        """The field's."""
        return self.field.start_seconds

    @property
    def end_seconds(self) -> float:
        """The field's."""
        return self.field.end_seconds

    def at_fps(self, fps: Fraction) -> "PlantedField":
        """The field for this framerate with the same correction: one motion has the same contacts at all of them."""
        return replace(self, field=at_fps(self.field, fps))

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        check_times(self, times_seconds)
        result: Poses | None = None
        for start in range(0, max(1, len(times_seconds)), TIMES_AT_ONCE):
            times = times_seconds[start : start + TIMES_AT_ONCE]
            poses = on_bones(self.field.query(times), self.bones)
            poses = with_offsets(poses, self.correction.at(times), self.legs, self.skeleton)
            if len(times_seconds) <= TIMES_AT_ONCE:
                return poses
            result = result or poses.room_for(len(times_seconds))
            result.put(slice(start, start + TIMES_AT_ONCE), poses)
        assert result is not None
        return result


def planted(field: MotionField, path: Path = "near") -> PlantedField:
    """A field with feet that stand; positions without rotations are brought onto bones of one length first.

    With a `free` path the body goes where feet that stand carry it, and may end elsewhere: for generated motion.
    Contacts are those that the field says (`KnowsContacts`), else they are looked for, at 120 instants a second or a
    little more, so that the last one is the field's end. Raises `SkeletonMapError` for a skeleton whose legs aren't
    known.
    """
    span = field.end_seconds - field.start_seconds
    count = int(np.ceil(span * GRID_FPS - 1e-6)) + 1
    fps = (count - 1) / span if count > 1 else GRID_FPS

    def seconds(rows: Int64[np.ndarray, "rows"]) -> Float64[np.ndarray, "rows"]:
        return np.minimum(field.start_seconds + rows / fps, field.end_seconds)

    def positions(rows: Int64[np.ndarray, "rows"]) -> Float32[np.ndarray, "rows joints 3"]:
        return field.query(seconds(rows)).joint_positions

    made = _planted(field, positions, fps, count, path)
    if contacts_of(field, seconds(np.zeros(1, np.int64))) is None:
        return made

    def down(start: int, stop: int) -> Bool[np.ndarray, "instants feet ends"]:
        probability = contacts_of(field, seconds(np.arange(start, stop)))
        assert probability is not None
        return np.asarray(probability > PROBABLY)

    return replace(made, correction=replace(made.correction, down=down))


def planted_frames(observation: Observed, frames: TimeGrid, path: Path = "near") -> PlantedField:
    """A motion's frames with feet that stand, to be asked for at their own times: nothing is made between them.

    At very high framerates every second frame, or third, is looked at.
    """
    step = max(1, round(float(frames.fps) / GRID_FPS))

    def positions(rows: Int64[np.ndarray, "rows"]) -> Float32[np.ndarray, "rows joints 3"]:
        return observation.rows(step * rows).poses.joint_positions

    field, count = INTERPOLATORS["hold"].encode(observation), (frames.num_frames - 1) // step + 1
    return _planted(field, positions, float(frames.fps / step), count, path)


def _planted(
    field: MotionField,
    positions: Callable[[Int64[np.ndarray, "rows"]], Float32[np.ndarray, "rows joints 3"]],
    fps: float,
    count: int,
    path: Path,
) -> PlantedField:
    """A field planted by its positions at the instants of a grid."""
    legs = legs_of(field.skeleton)
    bones = None
    if field.query(np.array([field.start_seconds])).local_rotations is None:
        some = np.unique(np.linspace(0, count - 1, min(count, BONE_SAMPLES)).astype(np.int64))
        bones = Bones.lacking(positions(some), field.skeleton, captured=path == "near")

    def seen(start: int, stop: int) -> Float32[np.ndarray, "instants joints 3"]:
        found = positions(np.arange(start, stop))
        return found if bones is None else bones.applied(found)

    return PlantedField(field, legs, bones, Correction(legs, seen, field.start_seconds, fps, count, path))


def on_bones(poses: Poses, bones: Bones | None) -> Poses:
    """Poses of positions with these bones; as they are where there are none."""
    return poses if bones is None else Poses(bones.applied(poses.joint_positions), None, poses.root_translation)


def with_offsets(poses: Poses, offsets: Float64[np.ndarray, "times 3 3"], legs: Legs, skeleton: Skeleton) -> Poses:
    """Poses whose body and feet are moved, legs bent to it; poses that nothing moves stay as they are."""
    rows = np.flatnonzero(np.abs(offsets).max(axis=(1, 2)) > _SMALL_METRES)
    if not len(rows):
        return poses
    some = poses.rows(rows)
    moved = _moved(some, offsets[rows], legs, skeleton)
    if len(rows) == len(offsets):
        return moved
    result = poses.joined(())
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
        bent = bend(hip, knee, ankle, ankle + offsets[:, 1 + foot], forward)
        step = (bent.ankle - ankle).astype(np.float32)
        for joint in (leg.ankle, *leg.foot):
            positions[:, joint] += step
        inner = [joint for joint in (*leg.thigh, *leg.shank) if joint not in (leg.knee, leg.ankle)]
        if rotations is not None or inner:
            thigh, shank = turns(bent, hip, knee, ankle)
            _carry(positions, leg, bent, (hip, knee), (thigh, shank))
            turned |= dict.fromkeys((leg.hip, *(set(leg.thigh) - {leg.knee})), thigh)
            turned |= dict.fromkeys((leg.knee, *(set(leg.shank) - {leg.ankle})), shank)
        positions[:, leg.knee] = bent.knee
    translation = poses.root_translation
    if translation is not None:
        translation = translation + offsets[:, 0].astype(np.float32)
    if rotations is not None:
        rotations = turned_rotations(rotations, turned, skeleton)
    return Poses(positions, rotations, translation)


def _chain(leg: Leg) -> tuple[int, int, int]:
    return leg.hip, leg.knee, leg.ankle


def _carry(
    positions: Float32[np.ndarray, "times joints 3"],
    leg: Leg,
    bent: BentLeg,
    old: tuple[Float64[np.ndarray, "times 3"], Float64[np.ndarray, "times 3"]],
    turned: tuple[Float64[np.ndarray, "times 4"], Float64[np.ndarray, "times 4"]],
) -> None:
    """Joints that lie still in thigh and shank go along with them: twist joints, pads, ends of bones."""
    hip, knee = old
    for joints, start, new, turn in ((leg.thigh, hip, hip, turned[0]), (leg.shank, knee, bent.knee, turned[1])):
        for joint in joints:
            if joint not in (leg.knee, leg.ankle):
                positions[:, joint] = new + quaternion_rotate(turn, positions[:, joint] - start)


def turned_rotations(
    rotations: Float32[np.ndarray, "times joints 4"],
    turned: dict[int, Float64[np.ndarray, "times 4"]],
    skeleton: Skeleton,
) -> Float32[np.ndarray, "times joints 4"]:
    """Local rotations of joints that have turned in the world, and of those that haven't below them."""
    result = rotations.copy()
    old: dict[int, Float64[np.ndarray, "times 4"]] = {}
    for joint, parent in enumerate(skeleton.parents):
        if joint not in turned and parent not in turned:
            continue
        local = _world(old, joint, rotations, skeleton)
        if joint in turned:
            local = quaternion_multiply(turned[joint], local)
        if parent >= 0:
            above = _world(old, parent, rotations, skeleton)
            if parent in turned:
                above = quaternion_multiply(turned[parent], above)
            local = quaternion_multiply(quaternion_conjugate(above), local)
        result[:, joint] = local / np.linalg.norm(local, axis=-1, keepdims=True)
    return result


def _world(
    known: dict[int, Float64[np.ndarray, "times 4"]],
    joint: int,
    rotations: Float32[np.ndarray, "times joints 4"],
    skeleton: Skeleton,
) -> Float64[np.ndarray, "times 4"]:
    """A joint's rotation in the world, which is then known; of a whole body few are needed."""
    if joint not in known:
        own, parent = rotations[:, joint].astype(np.float64), skeleton.parents[joint]
        known[joint] = own if parent < 0 else quaternion_multiply(_world(known, parent, rotations, skeleton), own)
    return known[joint]
