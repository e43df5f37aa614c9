"""Long motions from overlapping fields: each piece is placed in the world, neighbours are cross-faded.

NeRM's appendix B.3 assembles long motions from clips so that memory stays bounded. Its clips touch; here neighbours
overlap, because two fields that only touch agree neither in place nor in velocity. Pieces are read only where a query
needs them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from motionkit.core.kinematics import quaternion_multiply, quaternion_rotate, quaternion_slerp
from motionkit.core.shapes import Float, Float64, Int64
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import Joints, MotionField, Poses, Times, at_fps, check_times

SHORTEST_OVERLAP_SECONDS = 1e-3
_TIMES_TO_FIT = 16


@dataclass(frozen=True, eq=False)
class Piece:
    """A field within a longer motion: its start time, and its frame of reference in the world.

    `yaw` turns its poses about +Y (radians, Z+ towards X+), `origin` (x, z in metres) then moves them; both are those
    of `motionkit.data.windows.Windows`.
    """

    field: MotionField
    start_seconds: float
    yaw: float = 0.0
    origin: tuple[float, float] = (0.0, 0.0)

    @property
    def end_seconds(self) -> float:
        """End time in the longer motion."""
        return self.start_seconds + self.field.end_seconds - self.field.start_seconds

    def own_seconds(self, times_seconds: Times) -> Times:
        """Converts times of the longer motion to times of the field."""
        own = times_seconds - self.start_seconds + self.field.start_seconds
        return np.clip(own, self.field.start_seconds, self.field.end_seconds)

    def query(self, times_seconds: Times) -> Poses:
        """Poses in the world at times of the longer motion."""
        poses = self.field.query(self.own_seconds(times_seconds))
        if self.yaw == 0.0 and self.origin == (0.0, 0.0):
            return poses
        turn = np.array([np.cos(self.yaw / 2), 0.0, np.sin(self.yaw / 2), 0.0])
        moved = np.array([self.origin[0], 0.0, self.origin[1]])
        positions = (quaternion_rotate(turn, poses.joint_positions.astype(np.float64)) + moved).astype(np.float32)
        rotations, translation = poses.local_rotations, poses.root_translation
        if rotations is not None:
            rotations = rotations.copy()
            rotations[:, 0] = quaternion_multiply(turn, rotations[:, 0].astype(np.float64))
        if translation is not None:
            # The root's rest offset, which lies between the two, is the world's and does not turn.
            translation = positions[:, 0] - (poses.joint_positions[:, 0] - translation)
        return Poses(positions, rotations, translation)


@dataclass(frozen=True, eq=False)
class AssembledField:
    """A `MotionField` made of pieces; between `fade_start[k]` and `fade_end[k]` piece k gives way to piece k + 1.

    The weight of the next piece is 6u⁵ − 15u⁴ + 10u³ of the fade's fraction u, which begins and ends with no slope and
    no curvature: where the pieces have continuous velocity (acceleration), so has the whole. Poses with rotations mix
    these on great arcs (joints that differ by less than half a turn) and their bones and roots linearly, others mix
    joint positions linearly.
    """

    pieces: tuple[Piece, ...]
    fade_start: Float64[np.ndarray, "joins"]
    fade_end: Float64[np.ndarray, "joins"]

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of all pieces."""
        return self.pieces[0].field.skeleton

    @property
    def start_seconds(self) -> float:
        """Start of the first piece."""
        return self.pieces[0].start_seconds

    @property
    def end_seconds(self) -> float:
        """End of the last piece."""
        return self.pieces[-1].end_seconds

    def at_fps(self, fps: Fraction) -> "AssembledField":
        """The same motion, all pieces sampled at this framerate."""
        return replace(self, pieces=tuple(replace(piece, field=at_fps(piece.field, fps)) for piece in self.pieces))

    def query(self, times_seconds: Times) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it.

        Each piece is evaluated once, at its own times only.
        """
        check_times(self, times_seconds)
        first, weight = self._fades(times_seconds)
        result: Poses | None = None
        fading = weight > 0.0
        for number in np.union1d(first, first[fading] + 1).tolist() or [0]:
            rows = np.flatnonzero((first == number) | (fading & (first == number - 1)))
            poses = self.pieces[number].query(times_seconds[rows])
            if result is None:
                result = poses.room_for(len(times_seconds))
            joins = first[rows] == number - 1
            if joins.any():
                before = result.rows(rows[joins])
                result.put(rows[joins], _mixed(before, poses.rows(joins), weight[rows[joins]], self.skeleton))
            result.put(rows[~joins], poses.rows(~joins))
        assert result is not None
        return result

    def _fades(self, times: Times) -> tuple[Int64[np.ndarray, "times"], Times]:
        """The first piece at each time, and the weight of the one after it: 0 outside their fade."""
        first = np.searchsorted(self.fade_end, times, side="right")
        start = np.append(self.fade_start, np.inf)[first]
        length = np.append(self.fade_end - self.fade_start, 1.0)[first]
        u = np.maximum(0.0, (times - start) / length)
        return first.astype(np.int64), u**3 * (u * (6.0 * u - 15.0) + 10.0)


def assemble(pieces: Sequence[Piece]) -> AssembledField:
    """One field from pieces in chronological order, each overlapping the next.

    A fade takes all of its overlap; where more than two pieces overlap it is shortened until fades do not meet. Raises
    `ValueError` for no piece, pieces out of order, and neighbours that overlap by less than a millisecond.
    """
    if not pieces:
        raise ValueError("nothing to assemble: give at least one piece")
    starts, ends = (np.array([getattr(piece, end) for piece in pieces]) for end in ("start_seconds", "end_seconds"))
    apart = np.concatenate((np.diff(starts), np.diff(ends), ends[:-1] - starts[1:]))
    if (apart < SHORTEST_OVERLAP_SECONDS).any():
        raise ValueError(
            f"pieces start at {starts} and end at {ends} s: each must start and end after the one before it, and "
            f"overlap it by {SHORTEST_OVERLAP_SECONDS:g} s or more, for the cross-fade"
        )
    centre = (starts[1:] + ends[:-1]) / 2
    half = (ends[:-1] - starts[1:]) / 2
    room = np.diff(centre) / 2
    half[1:] = np.minimum(half[1:], room)
    half[:-1] = np.minimum(half[:-1], room)
    return AssembledField(tuple(pieces), centre - half, centre + half)


def laid(field: MotionField, yaw: float, origin: tuple[float, float]) -> MotionField:
    """A motion turned about +Y and moved on the floor; itself if there is no transform."""
    if yaw == 0.0 and origin == (0.0, 0.0):
        return field
    return assemble([Piece(field, field.start_seconds, yaw, origin)])


def chain(fields: Sequence[MotionField], overlap_seconds: float) -> AssembledField:
    """Concatenates separate motions: each is turned and moved so that it continues where the previous one ends.

    The turn about +Y and the shift on the floor best align its first `overlap_seconds` with the last ones of the
    previous motion (least squares over all joints); heights are kept. Raises what `assemble` raises.
    """
    pieces: list[Piece] = []
    for field in fields:
        if not pieces:
            pieces.append(Piece(field, 0.0))
            continue
        last, start = pieces[-1], pieces[-1].end_seconds - overlap_seconds
        since = np.linspace(0.0, overlap_seconds, _TIMES_TO_FIT)
        yaw, origin = _laid_over(
            field.query(field.start_seconds + since).joint_positions,
            last.query(np.clip(start + since, last.start_seconds, last.end_seconds)).joint_positions,
        )
        pieces.append(Piece(field, start, yaw, origin))
    return assemble(pieces)


def even_starts(span_seconds: float, longest_seconds: float, overlap_seconds: float) -> Float64[np.ndarray, "pieces"]:
    """Evenly spread starts of as few pieces as cover [0, span] with this overlap or more.

    Each piece lasts min(span, longest); 0 < overlap < longest.
    """
    if span_seconds <= longest_seconds:
        return np.zeros(1)
    count = int(np.ceil((span_seconds - overlap_seconds) / (longest_seconds - overlap_seconds) - 1e-9))
    return np.linspace(0.0, span_seconds - longest_seconds, max(2, count))


def _laid_over(
    mine: Float[np.ndarray, "times joints 3"], target: Float[np.ndarray, "times joints 3"]
) -> tuple[float, tuple[float, float]]:
    a, b = (positions.reshape(-1, 3)[:, (0, 2)].astype(np.float64) for positions in (mine, target))
    a_mean, b_mean = a.mean(axis=0), b.mean(axis=0)
    (ax, az), (bx, bz) = (a - a_mean).T, (b - b_mean).T
    yaw = float(np.arctan2(np.sum(bx * az - bz * ax), np.sum(bx * ax + bz * az)))
    sine, cosine = np.sin(yaw), np.cos(yaw)
    turned = np.array([cosine * a_mean[0] + sine * a_mean[1], cosine * a_mean[1] - sine * a_mean[0]])
    x, z = b_mean - turned
    return yaw, (float(x), float(z))


def _mixed(a: Poses, b: Poses, weight: Times, skeleton: Skeleton) -> Poses:
    one = weight[:, None]

    def lerp(
        first: Float[np.ndarray, "times *rest"], second: Float[np.ndarray, "times *rest"]
    ) -> Float64[np.ndarray, "times *rest"]:
        share = weight.reshape(-1, *(1,) * (first.ndim - 1))
        return np.asarray((1.0 - share) * first + share * second)

    translation = None
    if a.root_translation is not None and b.root_translation is not None:
        translation = lerp(a.root_translation, b.root_translation).astype(np.float32)
    if a.local_rotations is None or b.local_rotations is None:
        return Poses(lerp(a.joint_positions, b.joint_positions).astype(np.float32), None, translation)
    first, second = Joints.of(a, skeleton), Joints.of(b, skeleton)
    rotations = quaternion_slerp(first.rotations, second.rotations, one)
    joints = Joints(rotations, lerp(first.bones, second.bones), lerp(first.root, second.root))
    return Poses(joints.positions(skeleton), rotations.astype(np.float32), translation)
