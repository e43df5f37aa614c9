"""The nearest training motion to every short stretch of a motion, invariant to body, tempo, mirroring and direction.

Motions are compared at 20 fps, low-passed at 5 Hz. A pose is the bones of the 22-joint layout with the reference body's
lengths, so size and proportions do not matter; stretches are aligned by a rotation about the vertical, so place and
heading do not matter. A motion is played at nine tempi, to match training motion at 0.8 to 1.25 times its tempo, and
each stretch is searched for as it is, mirrored, reversed, and both. The distance of two stretches is the root mean
square difference of bones over poses, in metres on the reference body.
"""

from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from threadpoolctl import threadpool_limits

from eval.sets.sets import SampleSet
from eval.sets.stretches import FPS, PARENTS, POSE_EVERY, Stretches, Tracks, flat, numbers, unit
from motionkit.core.shapes import Bool, Float32, Float64, Int64

HOP_FRAMES = 10
TEMPI = tuple(Fraction(1.25 ** (step / 4)).limit_denominator(400) for step in range(-4, 5))
OWN_TEMPO = len(TEMPI) // 2
STRETCH_SECONDS = (0.5, 1.0, 2.0)
NUM_COMPONENTS = 32
BASIS_STRETCHES = 512
MOST_FASTER = 0.03
CANDIDATES = 16
BLOCKS_KEPT = 2
BLOCK_ROWS = 256
BLOCK_QUERIES = 512
BLOCK_STRETCHES = 4096
TINY = 1e-12


WAYS = ((False, False), (True, False), (False, True), (True, True))
"""(mirrored, reversed): the variants of a stretch that are searched for."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Stretches of one length, one every 0.1 s, projected onto principal components.

    Row i begins at frame `start[i]` of sequence `sequence[i]`; `step` is the squared distance to the next row of the
    same sequence, 0 for the last.
    """

    num_poses: int
    start: Int64[np.ndarray, "rows"]
    sequence: Int64[np.ndarray, "rows"]
    mean: Float32[np.ndarray, "numbers"]
    components: Float32[np.ndarray, "numbers components"]
    values: Float32[np.ndarray, "rows components"]
    step: Float32[np.ndarray, "rows"]

    @classmethod
    def of(cls, tracks: Tracks, num_poses: int) -> "Rows":
        """Raises `ValueError` if no sequence holds a stretch."""
        start, sequence = tracks.starts(num_poses, POSE_EVERY)
        if not len(start):
            raise ValueError(f"no training sequence holds a stretch of {num_poses} poses at {FPS / POSE_EVERY} fps")
        start += tracks.first[sequence]
        rows = tracks.track.stretches(start[:: -(-len(start) // BASIS_STRETCHES)], num_poses).rows()
        mean = rows.mean(axis=0)
        components = np.linalg.svd(rows - mean, full_matrices=False)[2][:NUM_COMPONENTS].T
        blocks = np.array_split(start, -(-len(start) // BLOCK_STRETCHES))
        values = np.concatenate(
            [(tracks.track.stretches(each, num_poses).rows() - mean) @ components for each in blocks]
        )
        ahead = np.diff(values, axis=0)
        step = np.append(np.where(np.diff(sequence) == 0, np.einsum("rc,rc->r", ahead, ahead), 0), 0)
        return cls(num_poses, start, sequence, mean, components, values, step.astype(np.float32))

    def nearest(
        self, stretches: Stretches, apart: Bool[np.ndarray, "stretches sequences"] | None
    ) -> tuple[Float32[np.ndarray, "stretches kept"], Int64[np.ndarray, "stretches kept"]]:
        """The nearest blocks of rows in the components' space: their minimum squared distances and rows.

        Distances are to the segment from each row to the next.
        """
        queries = (stretches.rows() - self.mean) @ self.components
        squares = np.einsum("rc,rc->r", self.values, self.values)
        near, place = [], []
        for first in range(0, len(self.values), BLOCK_ROWS):
            # |r|² − 2 q · r: a query's own length doesn't change which is nearest.
            some = slice(first, first + BLOCK_ROWS + 1)
            found = _to_segments(queries @ (-2 * self.values[some]).T + squares[some], self.step[some])
            found = found[:, :BLOCK_ROWS]
            if apart is not None:
                own = self.sequence[first : first + BLOCK_ROWS]
                if apart[:, own[0] : own[-1] + 1].any():
                    found[apart[:, own]] = np.inf
            least = found.argmin(axis=1)
            near.append(found[np.arange(len(found)), least])
            place.append(least + first)
        nearest, places = np.stack(near, axis=1), np.stack(place, axis=1)
        nearest += np.einsum("qc,qc->q", queries, queries)[:, None]
        kept = np.argsort(nearest, axis=1)[:, :BLOCKS_KEPT]
        return np.take_along_axis(nearest, kept, axis=1), np.take_along_axis(places, kept, axis=1)


@dataclass(frozen=True, eq=False)
class TrainingMotion:
    """Training motion to search in; `rows` caches its stretches by length."""

    tracks: Tracks
    _made: dict[int, Rows] = field(default_factory=dict)

    @classmethod
    def of(cls, training: SampleSet) -> "TrainingMotion":
        """From a sample set at any framerate."""
        return cls(Tracks.of(training.sequences, training.fps))

    def rows(self, num_poses: int) -> Rows:
        """The stretches of `num_poses`; raises `ValueError` if no sequence holds one."""
        if num_poses not in self._made:
            self._made[num_poses] = Rows.of(self.tracks, num_poses)
        return self._made[num_poses]


@dataclass(frozen=True, eq=False)
class Nearest:
    """The nearest training stretch to each stretch of `seconds` seconds of the motions that hold one, in order.

    `motion` and `start_seconds` identify the stretch; `movement` is the deviation of its bones from their means,
    `distance` that from the nearest training stretch, both in metres; the latter is of `sequence`, at about `tempo`.
    """

    seconds: float
    motion: Int64[np.ndarray, "stretches"]
    start_seconds: Float64[np.ndarray, "stretches"]
    movement: Float64[np.ndarray, "stretches"]
    distance: Float64[np.ndarray, "stretches"]
    sequence: Int64[np.ndarray, "stretches"]
    tempo: Float64[np.ndarray, "stretches"]
    mirrored: Bool[np.ndarray, "stretches"]
    backwards: Bool[np.ndarray, "stretches"]


def nearest_training(
    samples: SampleSet, training: TrainingMotion, apart: Bool[np.ndarray, "motions sequences"] | None = None
) -> tuple[Nearest, ...]:
    """The nearest training stretch to every stretch of 0.5, 1 and 2 s, one every half second; at any framerate.

    Motions `apart` from a training sequence are not compared with it. Lengths are those in the training motion: of a
    motion at 1.25 times the tempo, 0.8 of that is compared. The nearest of each 256 training stretches, one every
    0.1 s, is found on 32 principal components; for the nearest of these, distances are exact and minimised over times
    and tempi in between. Raises `ValueError` if no training sequence holds a stretch of a length that motions hold.
    """
    played = [Tracks.of(samples.sequences, samples.fps / tempo) for tempo in TEMPI]
    found = []
    with threadpool_limits(1, "blas"):
        for seconds in STRETCH_SECONDS:
            queries = _Queries.of(played, _num_poses(seconds))
            if len(queries.motion):
                found.append(_nearest(seconds, queries, training, apart))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Queries:
    """The stretches to search for; `start` is the frame of its motion at which each begins."""

    played: list[Tracks]
    num_poses: int
    start: Int64[np.ndarray, "stretches"]
    motion: Int64[np.ndarray, "stretches"]

    @classmethod
    def of(cls, played: list[Tracks], num_poses: int) -> "_Queries":
        return cls(played, num_poses, *played[OWN_TEMPO].starts(num_poses, HOP_FRAMES))

    def held(self, some: Int64[np.ndarray, "some"], tempo: int) -> Bool[np.ndarray, "some"]:
        """Whether the motion, played at a tempo, is long enough."""
        return np.asarray(self.played[tempo].last_starts(self.num_poses)[self.motion[some]] >= 0)

    def variant(self, some: Int64[np.ndarray, "some"], tempo: int, way: int) -> Stretches:
        """The stretches `rows` at a tempo, in one of the four variants."""
        tracks, motion = self.played[tempo], self.motion[some]
        start = np.rint(self.start[some] * float(TEMPI[tempo])).astype(np.int64)
        frame = tracks.first[motion] + np.minimum(start, tracks.last_starts(self.num_poses)[motion])
        return tracks.track.stretches(frame, self.num_poses).transformed(*WAYS[way])


def _nearest(
    seconds: float, queries: _Queries, training: TrainingMotion, apart: Bool[np.ndarray, "motions sequences"] | None
) -> Nearest:
    number = len(queries.motion)
    rows = training.rows(queries.num_poses)
    blocks = np.array_split(np.arange(number), -(-number // BLOCK_QUERIES))
    parts = [_best(some, queries, training, apart) for some in blocks]
    squared, row, variant = (np.concatenate(each) for each in zip(*parts, strict=True))
    tempo, way = np.divmod(variant, len(WAYS))
    mirrored, backwards = np.array(WAYS)[way].T
    return Nearest(
        seconds=seconds,
        motion=queries.motion,
        start_seconds=queries.start / float(FPS),
        movement=queries.variant(np.arange(number), OWN_TEMPO, 0).movement(),
        distance=np.sqrt(squared),
        sequence=rows.sequence[row],
        tempo=np.array([float(each) for each in TEMPI])[tempo],
        mirrored=mirrored,
        backwards=backwards,
    )


def _best(
    some: Int64[np.ndarray, "some"],
    queries: _Queries,
    training: TrainingMotion,
    apart: Bool[np.ndarray, "motions sequences"] | None,
) -> tuple[Float64[np.ndarray, "some"], Int64[np.ndarray, "some"], Int64[np.ndarray, "some"]]:
    """The minimum mean squared distance per stretch, its row, and tempo · ways + way."""
    rows = training.rows(queries.num_poses)
    variants = range(len(TEMPI) * len(WAYS))
    kept = min(BLOCKS_KEPT, -(-len(rows.start) // BLOCK_ROWS))
    near = np.full((len(some), len(variants), kept), np.inf, dtype=np.float32)
    place = np.zeros(near.shape, dtype=np.int64)
    for variant in variants:
        tempo, way = divmod(variant, len(WAYS))
        held = queries.held(some, tempo)
        if held.any():
            own = None if apart is None else apart[queries.motion[some[held]]]
            near[held, variant], place[held, variant] = rows.nearest(queries.variant(some[held], tempo, way), own)
    flat_near = near.reshape(len(some), -1)
    nearest = np.argsort(flat_near, axis=1)[:, :CANDIDATES]
    chosen = np.take_along_axis(place.reshape(len(some), -1), nearest, axis=1)
    possible = np.isfinite(np.take_along_axis(flat_near, nearest, axis=1))
    squared = np.full(chosen.shape, np.inf)
    for variant in variants:
        which, rank = np.nonzero((nearest // kept == variant) & possible)
        if len(which):
            ours = queries.variant(some[which], *divmod(variant, len(WAYS)))
            squared[which, rank] = _least_squares(ours, training.tracks, rows, chosen[which, rank])
    best = squared.argmin(axis=1)
    each = np.arange(len(some))
    return squared[each, best], chosen[each, best], nearest[each, best] // kept


def _to_segments(
    squared: Float32[np.ndarray, "queries rows"], step: Float32[np.ndarray, "rows"]
) -> Float32[np.ndarray, "queries rows"]:
    """Squared distances to the segments from each row to the next, of those to the rows; in place.

    With x how much less the next row's is, and c what of it lies within ± step, that is h − x / 2 − step / 4 −
    (2 x c − c²) / (4 step): the foot of the perpendicular, or the nearer end where it lies beyond one.
    """
    last = np.flatnonzero(step == 0)
    less = np.zeros_like(squared)
    np.subtract(squared[:, :-1], squared[:, 1:], out=less[:, :-1])
    less[:, last] = 0
    inside = np.minimum(less, step)
    np.maximum(inside, -step, out=inside)
    squared -= step / 4
    squared -= less / 2
    less *= 2
    less -= inside
    less *= inside
    less *= 0.25 / (step + TINY)
    squared -= less
    return squared


def _least_squares(
    ours: Stretches, training: Tracks, rows: Rows, place: Int64[np.ndarray, "ours"]
) -> Float64[np.ndarray, "ours"]:
    """Mean square difference of bones to the stretch of training motion at a row, or somewhat before, after or faster.

    Each pair is turned about the vertical as it fits best. Frame by frame from one before to three after, training
    motion is taken to be linear within half a frame, and may run up to 3 % faster or slower, half a step of the tempi.
    """
    num_poses = ours.planar.shape[1]
    first = training.first[rows.sequence[place]]
    last = first + training.last_starts(num_poses)[rows.sequence[place]]
    frames = [np.clip(rows.start[place] + shift, first, last) for shift in range(-2, POSE_EVERY + 3)]
    theirs = [training.track.stretches(each, num_poses) for each in frames]
    poses = POSE_EVERY * (np.arange(num_poses) - (num_poses - 1) / 2)
    later = np.repeat(poses, len(PARENTS)).astype(np.float32)
    planar, upright = flat(ours.planar), flat(ours.upright)
    found = np.full(len(place), np.inf)
    for at in range(1, len(frames) - 1):
        here = flat(theirs[at].planar)
        back = unit(np.einsum("qn,qn->q", here.conj(), planar))[:, None]
        apart = np.concatenate((numbers(here * back - planar), flat(theirs[at].upright) - upright), axis=1)
        lag = np.maximum(frames[at + 1] - frames[at - 1], 1)[:, None].astype(np.float32)
        turned = flat(theirs[at + 1].planar - theirs[at - 1].planar) * (back / lag)
        speed = np.concatenate((numbers(turned), flat(theirs[at + 1].upright - theirs[at - 1].upright) / lag), axis=1)
        found = np.minimum(found, _between(apart, speed, np.tile(later, 3)))
    return np.asarray(found / (num_poses * len(PARENTS)))


def _dot(one: Float32[np.ndarray, "pairs n"], other: Float32[np.ndarray, "pairs n"]) -> Float64[np.ndarray, "pairs"]:
    return np.asarray(np.einsum("qn,qn->q", one, other), dtype=np.float64)


def _between(
    apart: Float32[np.ndarray, "pairs numbers"],
    speed: Float32[np.ndarray, "pairs numbers"],
    later: Float32[np.ndarray, "numbers"],
) -> Float64[np.ndarray, "pairs"]:
    """The least |apart + (shift + faster · later) · speed|² with at most half a frame of shift and 3 % faster."""
    stretched = speed * later
    a_a, a_v, a_w = _dot(apart, apart), _dot(apart, speed), _dot(apart, stretched)
    v_v, v_w, w_w = _dot(speed, speed) + TINY, _dot(speed, stretched), _dot(stretched, stretched) + TINY
    faster = (v_w * a_v - v_v * a_w) / np.maximum(v_v * w_w - v_w**2, TINY)
    faster = np.clip(faster, -MOST_FASTER, MOST_FASTER)
    shift = np.clip(-(a_v + faster * v_w) / v_v, -0.5, 0.5)
    least = a_a + shift**2 * v_v + faster**2 * w_w + 2 * (shift * a_v + faster * a_w + shift * faster * v_w)
    return np.asarray(np.clip(least, 0, a_a))


def _num_poses(seconds: float) -> int:
    return round(seconds * float(FPS) / POSE_EVERY)
