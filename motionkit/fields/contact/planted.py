"""Motion with planted feet: a motion field that wraps another, and the same for a motion's own frames.

The correction is a function of time: offsets of the body and of both feet, the solution of a banded least-squares
problem that is linear in the motion's length. The unknowns at every sample of the grid are the body's offset r and each
foot's additional offset f. The objective asks for velocities that cancel the sliding of feet in contact (ṙ + ḟ = −e)
and for heights on the ground; it penalises feet away from their original position (f², more while they swing) and
accelerations (f̈², r̈²). What both feet share ends up in r, which doesn't bend the knees; the rest fades out while a
foot swings.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from motionkit.core.kinematics import quaternion_rotate
from motionkit.core.shapes import Bool, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import TimeGrid, runs
from motionkit.fields.contact.bones import Bones, Leg, Legs, bend, legs_of, turns
from motionkit.fields.contact.detection import (
    CAPTURED,
    GENERATED,
    Contacts,
    FootPaths,
    Ground,
    PerEnd,
    PerFoot,
    find_contacts,
    ground_of,
    smoothstep,
)
from motionkit.fields.interpolation import INTERPOLATORS, Curve, curve
from motionkit.fields.motion_field import (
    DerivedField,
    MotionField,
    Observation,
    Poses,
    Times,
    at_fps,
    query_in_blocks,
    turned_rotations,
)

Path = Literal["near", "free", "kept"]
"""Whether the body returns to its path, may end elsewhere (where its planted feet carry it), or stays on its path.

If the path is `kept` (to a few centimetres), feet slide by what the legs cannot reach.
"""

KINDS = 3
"""Unknown offsets at every sample: of the body, the left and the right foot."""
_BAND = 2 * KINDS + 1


FOOT_DOWN_COST, FOOT_UP_COST = 0.05, 1.0
"""Costs of a foot's metres² from its original position in contact and in swing, relative to 1 for (m/s)² of sliding."""
LEVEL_BODY_COST, HEIGHT_BODY_COST = {"near": 0.02, "free": 1e-6, "kept": 3.0}, 0.3
"""Costs of the body's metres² from its original path on the ground, and in height."""
BODY_SUDDEN_COST, FOOT_SUDDEN_COST = 3e-3, 2e-4
"""Costs of (m/s²)² of the offsets of body and feet."""
REACH_METRES = {"near": (0.12, 0.25), "free": (0.15, 0.3), "kept": (0.15, 0.3)}
"""Feet that would need a larger offset beside the body were dragged or stand there by intent: not corrected."""
KEPT_SHARE = 0.02
"""Fraction of its velocity that a sliding foot keeps: real feet are never quite still."""
STEP_DOWN_METRES = (0.02, 0.04)
"""A captured foot lower than this, in a motion without sliding, steps down or pushes off: not corrected."""
FLOATING, SUNK, STEADY_HEIGHT = 100.0, 1000.0, 0.05
"""Costs of metres² above and below the ground, and of (m/s)² of an offset's vertical velocity."""
ABOVE_METRES, BELOW_METRES, HIGHEST_METRES = (0.03, 0.003), 0.003, (0.05, 0.08)
"""Tolerated heights above the ground, without and with sliding; tolerated depth; height that isn't corrected."""
HEIGHT_ROUNDS, TOLERATED_METRES = 2, 0.001
"""Feet that the other foot's correction pulls further below the ground are raised in a second pass."""

FEWEST_INSTANTS = 4
HELD = 1e9


@dataclass(frozen=True, eq=False)
class Correction:
    """Offsets of body, left and right foot, metres, at the samples of a grid, `fps` per second from `start_seconds` on.

    `ground` and `contacts` are those of the feet without the offsets.
    """

    start_seconds: float
    fps: float
    ground: Ground
    contacts: Contacts
    offsets: Float64[np.ndarray, "instants 3 3"]

    @cached_property
    def _curve(self) -> Curve:
        times = self.start_seconds + np.arange(len(self.offsets)) / self.fps
        return curve("catmull-rom", times, self.offsets)

    def at(self, times_seconds: Times) -> Float64[np.ndarray, "times 3 3"]:
        """The offsets at any times, by C1 cubic interpolation; constant before the first sample and after the last."""
        return self._curve.clamped(times_seconds)


def offsets_of(
    paths: FootPaths, contacts: Contacts, ground: Ground, fps: float, path: Path
) -> Float64[np.ndarray, "instants 3 3"]:
    """The offsets of body, left and right foot at every sample of the grid, metres."""
    offsets = np.zeros((len(paths), 3, 3))
    both = np.minimum(contacts.hold[1:], contacts.hold[:-1])
    if contacts.sliding.any():
        offsets[..., [0, 2]] = _level_offsets(contacts, fps, path)
    heights = paths[..., 1]
    lowest = _lowest(heights, contacts, ground, path)
    raised = np.zeros(contacts.hold.shape)
    for _ in range(HEIGHT_ROUNDS):
        height, weight = _heights(heights, raised, lowest, contacts, ground)
        if not height.any():
            break
        velocity = np.zeros((*both.shape, 1)), STEADY_HEIGHT * both
        offsets[..., [1]] = solve_offsets(velocity, (height[..., None], weight), contacts.hold, fps, HEIGHT_BODY_COST)
        raised = offsets[:, 0, [1]] + offsets[:, 1:, 1]
        if (heights + raised[..., None] > lowest - TOLERATED_METRES).all():
            break
    return offsets


def _level_offsets(contacts: Contacts, fps: float, path: Path) -> Float64[np.ndarray, "instants 3 2"]:
    """Offsets along X and Z that remove the sliding of feet in contact, where the legs can reach.

    A captured foot may slide beside one that rests.
    """
    share = contacts.sliding * (1.0 - contacts.beside) if path == "near" else contacts.sliding
    slid = contacts.velocity[..., [0, 2]] * ((1.0 - KEPT_SHARE) * share)[..., None]
    target = -0.5 * (slid[1:] + slid[:-1])
    offsets = _carried(target, contacts.hold, contacts.lead, fps, LEVEL_BODY_COST[path])
    within = _within_reach(offsets[:, 1:], contacts, path)
    if (within < 1.0).any():
        offsets = _carried(target, contacts.hold * within, contacts.lead * within, fps, LEVEL_BODY_COST[path])
    return offsets


def _carried(
    target: Float64[np.ndarray, "steps feet 2"], hold: PerFoot, lead: PerFoot, fps: float, body_cost: float
) -> Float64[np.ndarray, "instants 3 2"]:
    """Offsets that compensate these velocities while feet are held: the body's first, then the feet's again."""
    both = np.minimum(hold[1:], hold[:-1])
    anywhere = np.zeros((*lead.shape, 2)), np.zeros(lead.shape)
    offsets = solve_offsets((target, both), anywhere, hold, fps, body_cost)
    # The feet again with the body fixed: legs absorb the velocities of feet in transition that the body ignored.
    step = np.diff(offsets[:, :1], axis=0) * fps
    remaining = target - step, np.minimum(lead[1:], lead[:-1])
    offsets[:, 1:] = solve_offsets(remaining, anywhere, lead, fps, HELD)[:, 1:]
    return offsets


def _within_reach(feet: Float64[np.ndarray, "instants feet 2"], contacts: Contacts, path: Path) -> PerFoot:
    """1 if a foot stays near its original offset from the body, 0 if far; per whole contact for captures."""
    distance = np.hypot(feet[..., 0], feet[..., 1])
    if path == "near":
        distance = _largest(distance, np.asarray(contacts.down.any(axis=-1)))
    return 1.0 - smoothstep(distance, *REACH_METRES[path])


def _largest(values: PerFoot, during: Bool[np.ndarray, "instants feet"]) -> PerFoot:
    """Each segment's maximum over the whole segment; 0 between."""
    offsets = np.zeros_like(values)
    for foot in range(2):
        starts, stops = runs(during[:, foot])
        if len(starts):
            largest = np.maximum.reduceat(np.where(during[:, foot], values[:, foot], 0.0), starts)
            offsets[during[:, foot], foot] = np.repeat(largest, stops - starts)
    return offsets


def _lowest(heights: PerEnd, contacts: Contacts, ground: Ground, path: Path) -> PerEnd:
    """Lowest allowed foot height: the feet's level if the motion slides, the range of real feet otherwise.

    With a free path (generated motion) there is one floor, the lower foot's level. Captured feet may be far below
    theirs, at a step down or as a toe pushes off.
    """
    floor = ground.floor - BELOW_METRES
    lowest = floor + (np.maximum(ground.level - BELOW_METRES, floor) - floor) * contacts.sliding[..., None]
    if path != "near":
        one_floor = max(ground.bottom, ground.level.min()) - BELOW_METRES if path == "free" else -np.inf
        return np.asarray(np.maximum(lowest, one_floor))
    depth = (lowest - heights).max(axis=-1)
    down = smoothstep(_largest(depth, depth > 0), *STEP_DOWN_METRES) * (1.0 - contacts.sliding)
    return np.asarray(lowest - (down * np.maximum(depth, 0.0))[..., None])


def _heights(
    height: PerEnd, raised: PerFoot, lowest: PerEnd, contacts: Contacts, ground: Ground
) -> tuple[PerFoot, PerFoot]:
    """Target rise of each foot and its weight: for the lower end of a planted foot, and any end below the ground.

    Ends count as below the ground before or after they have been `raised`.
    """
    sliding = contacts.sliding[..., None]
    above = ABOVE_METRES[0] + (ABOVE_METRES[1] - ABOVE_METRES[0]) * sliding
    floats = np.where(contacts.down, np.maximum(height - ground.level - above, 0.0), np.inf).min(axis=-1)
    # Feet held or standing higher are on a step, on tiptoe, or in the air.
    floats = np.where(floats < HIGHEST_METRES[1], floats, 0.0)
    floats *= np.clip((HIGHEST_METRES[1] - floats) / (HIGHEST_METRES[1] - HIGHEST_METRES[0]), 0.0, 1.0)
    sunk = (lowest - height).max(axis=-1)
    is_sunk = sunk > np.minimum(raised, 0.0)
    return np.where(is_sunk, sunk, -floats), np.where(is_sunk, SUNK, FLOATING * contacts.hold)


def solve_offsets(
    velocity: tuple[Float64[np.ndarray, "steps feet axes"], Float64[np.ndarray, "steps feet"]],
    place: tuple[Float64[np.ndarray, "instants feet axes"], PerFoot],
    down: PerFoot,
    fps: float,
    body_cost: float,
) -> Float64[np.ndarray, "instants 3 axes"]:
    """The least-cost offsets of body, left and right foot, metres; a foot's total offset is body plus foot.

    `velocity` (m/s, between neighbours) and `place` (m) are targets of a foot's total offset, each with its weights.
    """
    from scipy.linalg import solveh_banded

    count, axes = len(down), place[0].shape[-1]
    band = np.zeros((_BAND, count, KINDS))  # band[d, t, k]: the entry of unknown (t, k) and the one d places after it
    right = np.zeros((count, KINDS, axes))
    # Distance from the original position.
    band[0, :, 0] += body_cost
    band[0, :, 1:] += FOOT_UP_COST + (FOOT_DOWN_COST - FOOT_UP_COST) * down
    # Acceleration: squares of second differences.
    sudden = np.array([BODY_SUDDEN_COST, FOOT_SUDDEN_COST, FOOT_SUDDEN_COST]) * fps**4
    for first, factor in ((0, 1.0), (1, -2.0), (2, 1.0)):
        for second, other in ((0, 1.0), (1, -2.0), (2, 1.0)):
            if second >= first:
                stop = count - 2 + first
                band[KINDS * (second - first), first:stop] += sudden * factor * other
    for foot in (1, 2):
        # Velocity: weight · |(r + f)(t + 1) − (r + f)(t) − v/fps|² · fps².
        weight = velocity[1][:, foot - 1] * fps**2
        pull = weight[:, None] * velocity[0][:, foot - 1] / fps
        for rows, sign in ((slice(None, -1), -1.0), (slice(1, None), 1.0)):
            for kind in (0, foot):
                band[0, rows, kind] += weight
                right[rows, kind] += sign * pull
            band[foot, rows, 0] += weight  # body and foot of one sample
        for kind in (0, foot):
            band[KINDS, :-1, kind] -= weight  # each with itself one sample later
        band[KINDS + foot, :-1, 0] -= weight  # the body with the foot one sample later
        band[KINDS - foot, :-1, foot] -= weight  # the foot with the body one sample later
        # Place: weight · |(r + f) − p|².
        weight = place[1][:, foot - 1]
        for kind in (0, foot):
            band[0, :, kind] += weight
            right[:, kind] += weight[:, None] * place[0][:, foot - 1]
        band[foot, :, 0] += weight
    lower = band.reshape(_BAND, count * KINDS)
    solved = solveh_banded(lower, right.reshape(count * KINDS, axes), lower=True, overwrite_ab=True, check_finite=False)
    return np.asarray(solved).reshape(count, KINDS, axes)


GRID_FPS = 120.0
BONE_SAMPLES = 512
_UP = np.array([0.0, 1.0, 0.0])
_SMALL_METRES = 1e-7


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
    Contacts are detected at 120 Hz or slightly more, so that the last sample is the field's end. Raises
    `SkeletonMapError` for a skeleton whose legs aren't known.
    """
    span = field.end_seconds - field.start_seconds
    count = int(np.ceil(span * GRID_FPS - 1e-6)) + 1
    fps = (count - 1) / span if count > 1 else GRID_FPS
    times = np.minimum(field.start_seconds + np.arange(count) / fps, field.end_seconds)
    return _planting(field, field.query(times), fps, path).derived()


def planted_frames(observation: Observation, frames: TimeGrid, path: Path = "near") -> Planting:
    """A motion's frames with planted feet, defined at the frames' own times only.

    At very high framerates only every second frame, or third, is used for detection.
    """
    step = max(1, round(float(frames.fps) / GRID_FPS))
    field = INTERPOLATORS["hold"].encode(observation)
    return _planting(field, observation.poses.rows(slice(None, None, step)), float(frames.fps / step), path)


def _planting(field: MotionField, poses: Poses, fps: float, path: Path) -> Planting:
    """The planting of a field by its poses at the samples of a grid."""
    legs, bones, positions = legs_of(field.skeleton), None, poses.joint_positions
    if poses.local_rotations is None:
        some = np.unique(np.linspace(0, len(positions) - 1, min(len(positions), BONE_SAMPLES)).astype(np.int64))
        bones = Bones.lacking(positions[some], field.skeleton, captured=path == "near")
        if bones is not None:
            positions = bones.applied(positions, legs.feet)
    paths = legs.foot_paths(positions).astype(np.float64)
    ground = ground_of(paths, fps)
    contacts = find_contacts(paths, fps, ground, CAPTURED if path == "near" else GENERATED)
    offsets = np.zeros((len(paths), KINDS, 3))
    if len(paths) >= FEWEST_INSTANTS:
        offsets = offsets_of(paths, contacts, ground, fps, path)
    return Planting(field, legs, bones, Correction(field.start_seconds, fps, ground, contacts, offsets))


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
