"""The nearest training motion to every short stretch of a motion, whatever body, tempo, side and direction it has.

Motions are compared at 20 fps, low-passed at 5 Hz. A pose is the bones of the 22-joint layout, each as long as in the
reference body, so neither size nor proportions count; stretches are turned about the vertical as they fit best, so
neither place nor heading counts. Training motion is played at nine tempi from 0.8 to 1.25, and each stretch is looked
for as it is, mirrored, played backwards, and both. The distance of two stretches is the root mean square over poses and
bones of the difference between two bones, in metres on the reference body.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt
from jaxtyping import Bool, Complex64, Float32, Float64, Int64, Shaped

from eval.sets.corruptions import low_pass
from eval.sets.sets import SampleSet
from motionkit.core.mirror import mirror_positions
from motionkit.core.skeleton import SMPL22
from motionkit.features.field import heading
from motionkit.fields.resample import resample_positions

FPS = Fraction(20)
SMOOTH_HZ = 5.0
POSE_EVERY = 2
HOP_FRAMES = 10
TEMPI = tuple(Fraction(1.25 ** (step / 4)).limit_denominator(400) for step in range(-4, 5))
STRETCH_SECONDS = (0.5, 1.0, 2.0)
NUM_COMPONENTS = 32
BASIS_STRETCHES = 512
CANDIDATES = 4
PLACES = 2
BLOCK_FRAMES = 8192
BLOCK_QUERIES = 1024
SHORTEST_BONE = 1e-6
TINY = 1e-12
PARENTS = np.array(SMPL22.parents[1:])


def _bone_lengths() -> Float64[np.ndarray, "bones 1"]:
    """Of the reference body, left and right alike, so that a mirrored copy has the same bones."""
    lengths = np.linalg.norm(SMPL22.offsets, axis=-1)
    for pair in SMPL22.left_right_pairs:
        lengths[list(pair)] = lengths[list(pair)].mean()
    return np.asarray(lengths[1:, None], dtype=np.float64)


BONE_LENGTHS = _bone_lengths()


@dataclass(frozen=True, eq=False)
class Stretches:
    """Bones of stretches of equally many poses: on the ground plane as z + ix, and upright; metres.

    `turn` sums the directions (z + ix) that the poses face.
    """

    planar: Complex64[np.ndarray, "stretches poses bones"]
    upright: Float32[np.ndarray, "stretches poses bones"]
    turn: Complex64[np.ndarray, "stretches"]

    def rows(self) -> Float32[np.ndarray, "stretches numbers"]:
        """All numbers of each, turned to face Z+ on the average."""
        length = np.abs(self.turn)
        back = np.where(length > 0, self.turn.conj() / np.where(length > 0, length, 1), 1)
        planar = _flat(self.planar) * back[:, None].astype(np.complex64)
        return np.concatenate((planar.real, planar.imag, _flat(self.upright)), axis=1)

    def movement(self) -> Float64[np.ndarray, "stretches"]:
        """Root mean square over poses and bones of a bone's distance from its mean over the stretch, metres."""
        planar = self.planar - self.planar.mean(axis=1, keepdims=True)
        upright = self.upright - self.upright.mean(axis=1, keepdims=True)
        squares = np.abs(planar) ** 2 + upright**2
        return np.asarray(np.sqrt(squares.mean(axis=(1, 2), dtype=np.float64)))


@dataclass(frozen=True, eq=False)
class Track:
    """What of a motion is compared: its bones at 20 fps, as in `Stretches`, and the direction that each pose faces."""

    planar: Complex64[np.ndarray, "frames bones"]
    upright: Float32[np.ndarray, "frames bones"]
    facing: Complex64[np.ndarray, "frames"]

    @classmethod
    def of(cls, positions: Float32[np.ndarray, "frames joints 3"], fps: Fraction) -> "Track":
        """Of joint positions of the 22-joint layout; given fps × tempo they are played at that tempo."""
        smooth = low_pass(resample_positions(positions, fps, FPS).astype(np.float64), float(FPS), SMOOTH_HZ)
        bones = smooth[:, 1:] - smooth[:, PARENTS]
        bones *= BONE_LENGTHS / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), SHORTEST_BONE)
        planar = (bones[..., 2] + 1j * bones[..., 0]).astype(np.complex64)
        facing = np.exp(1j * heading(smooth)).astype(np.complex64)
        return cls(planar, bones[..., 1].astype(np.float32), facing)

    def stretches(self, starts: Int64[np.ndarray, "stretches"], num_poses: int) -> Stretches:
        """Stretches of `num_poses` poses, every second frame, from the given frames on."""
        frames = starts[:, None] + POSE_EVERY * np.arange(num_poses)
        return Stretches(self.planar[frames], self.upright[frames], self.facing[frames].sum(axis=1))


@dataclass(frozen=True, eq=False)
class Nearest:
    """The nearest training stretch to each stretch of `seconds` seconds of the motions that hold one, in order.

    `motion` and `start_seconds` say which stretch it is; `movement` is how far its bones leave their means, `distance`
    how far the nearest training stretch is, both in metres; that is of `sequence`, played at `tempo`.
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
    samples: SampleSet, training: SampleSet, apart: Bool[np.ndarray, "motions sequences"] | None = None
) -> tuple[Nearest, ...]:
    """The nearest training stretch to every stretch of 0.5, 1 and 2 s, one every half second; sets at any framerate.

    Motions `apart` from a training sequence are not compared with it. For each of the four ways the four nearest
    sequences, each at a tempo, are found on 32 principal components of stretches that start every 0.1 s; in these,
    distances are exact, and lie between frames too. Raises `ValueError` where no training sequence holds a stretch of a
    length that motions hold.
    """
    plain = _Laid.of(samples.sequences, samples.fps)
    images = _Laid.of((mirror_positions(each, SMPL22.left_right_pairs) for each in samples.sequences), samples.fps)
    searches = [
        _Search(seconds, plain, images, training, apart)
        for seconds in STRETCH_SECONDS
        if len(plain.starts(_num_poses(seconds), HOP_FRAMES)[0])
    ]
    for number, tempo in enumerate(TEMPI):
        for first, laid in _blocks(training, tempo):
            for search in searches:
                search.look_at(first, number, laid)
    for sequence, positions in enumerate(training.sequences):
        for number, tempo in enumerate(TEMPI):
            wanting = [search.candidates_at(sequence, number) for search in searches]
            if any(len(rows) for rows in wanting):
                track = Track.of(positions, training.fps * tempo)
                for search, rows in zip(searches, wanting, strict=True):
                    search.compare(rows, sequence, number, track)
    return tuple(search.found() for search in searches)


WAYS = ((False, False), (True, False), (False, True), (True, True))
"""Mirrored, backwards: how a stretch is looked for."""


@dataclass(frozen=True, eq=False)
class _Laid:
    """Tracks one after another; sequence i begins at frame `first[i]`."""

    track: Track
    first: Int64[np.ndarray, "sequences"]
    num_frames: Int64[np.ndarray, "sequences"]

    @classmethod
    def of(cls, sequences: Iterable[Float32[np.ndarray, "_frames joints 3"]], fps: Fraction) -> "_Laid":
        return cls.joined([Track.of(each, fps) for each in sequences])

    @classmethod
    def joined(cls, tracks: Sequence[Track]) -> "_Laid":
        lengths = np.array([len(each.facing) for each in tracks], dtype=np.int64)
        joined = (np.concatenate([getattr(each, name) for each in tracks]) for name in ("planar", "upright", "facing"))
        return cls(Track(*joined), np.cumsum(lengths) - lengths, lengths)

    def starts(self, num_poses: int, every: int) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
        """The first frames of all stretches, one every so many frames of each sequence, and whose they are."""
        last = self.num_frames - POSE_EVERY * (num_poses - 1)
        numbers = np.maximum(0, -(-last // every))
        whose = np.repeat(np.arange(len(numbers)), numbers)
        place = np.arange(len(whose)) - np.repeat(np.cumsum(numbers) - numbers, numbers)
        return self.first[whose] + every * place, whose


def _blocks(training: SampleSet, tempo: Fraction) -> Iterator[tuple[int, _Laid]]:
    """Training sequences played at a tempo, a few thousand frames at a time, with the first one's number."""
    tracks: list[Track] = []
    first = 0
    for number, positions in enumerate(training.sequences):
        tracks.append(Track.of(positions, training.fps * tempo))
        if sum(len(each.facing) for each in tracks) >= BLOCK_FRAMES or number + 1 == training.num_sequences:
            yield first, _Laid.joined(tracks)
            tracks, first = [], number + 1


@dataclass(frozen=True, eq=False)
class _Basis:
    """Principal components of the rows of training stretches of one length."""

    mean: Float32[np.ndarray, "numbers"]
    components: Float32[np.ndarray, "numbers components"]

    @classmethod
    def of(cls, training: SampleSet, num_poses: int) -> "_Basis":
        every = HOP_FRAMES
        # So many hops that a few hundred stretches of all sequences together are looked at.
        every *= max(1, int(training.duration_seconds * float(FPS) / HOP_FRAMES) // BASIS_STRETCHES)
        rows = []
        for _, laid in _blocks(training, Fraction(1)):
            starts, _ = laid.starts(num_poses, every)
            rows.append(laid.track.stretches(starts, num_poses).rows())
        found = np.concatenate(rows)
        if not len(found):
            raise ValueError(f"no training sequence holds a stretch of {num_poses} poses at {FPS / POSE_EVERY} fps")
        mean = found.mean(axis=0)
        _, _, vectors = np.linalg.svd(found - mean, full_matrices=False)
        return cls(mean, np.ascontiguousarray(vectors[:NUM_COMPONENTS].T))

    def project(self, stretches: Stretches) -> Float32[np.ndarray, "stretches components"]:
        return np.asarray((stretches.rows() - self.mean) @ self.components)


class _Search:
    """The search for what is nearest to all stretches of one length, and the best of what it has seen.

    Row w · n + i is stretch i of n in the w-th way. Candidates are sequence · tempi + tempo.
    """

    def __init__(
        self,
        seconds: float,
        plain: _Laid,
        images: _Laid,
        training: SampleSet,
        apart: Bool[np.ndarray, "motions sequences"] | None,
    ) -> None:
        self.seconds, self.num_poses = seconds, _num_poses(seconds)
        self.laid, self.apart = (plain, images), apart
        self.start, self.motion = plain.starts(self.num_poses, HOP_FRAMES)
        self.basis = _Basis.of(training, self.num_poses)
        rows = np.arange(len(WAYS) * len(self.start))
        self.components = np.concatenate(
            [self.basis.project(self._stretches(some)) for some in np.array_split(rows, -(-len(rows) // BLOCK_QUERIES))]
        )
        self.near = np.full((len(rows), CANDIDATES), np.inf, dtype=np.float32)
        self.candidates = np.full((len(rows), CANDIDATES), -1)
        self.best = np.full(len(rows), np.inf)
        self.best_candidate = np.zeros(len(rows), dtype=np.int64)

    def _stretches(self, rows: Int64[np.ndarray, "some"]) -> Stretches:
        way, which = np.divmod(rows, len(self.start))
        found = [laid.track.stretches(self.start[which], self.num_poses) for laid in self.laid]
        mirrored, backwards = np.array(WAYS)[way].T
        planar, upright, turn = (
            np.where(mirrored.reshape(-1, *[1] * (plain.ndim - 1)), image, plain)
            for plain, image in zip(*(_parts(each) for each in found), strict=True)
        )
        planar[backwards], upright[backwards] = planar[backwards, ::-1], upright[backwards, ::-1]
        return Stretches(planar, upright, turn)

    def look_at(self, first: int, tempo: int, laid: _Laid) -> None:
        """Keep as candidates the sequences of a block that come nearest on the components."""
        starts, whose = laid.starts(self.num_poses, POSE_EVERY)
        if not len(starts):
            return
        rows = self.basis.project(laid.track.stretches(starts, self.num_poses))
        present, begin = np.unique(whose, return_index=True)
        numbers = (first + present) * len(TEMPI) + tempo
        motion = np.tile(self.motion, len(WAYS))
        for start in range(0, len(self.components), BLOCK_QUERIES):
            some = slice(start, start + BLOCK_QUERIES)
            least = np.minimum.reduceat(_to_segments(self.components[some], rows, whose), begin, axis=1)
            if self.apart is not None:
                least[self.apart[motion[some]][:, first + present]] = np.inf
            near = np.concatenate((self.near[some], least), axis=1)
            candidates = np.concatenate((self.candidates[some], np.broadcast_to(numbers, least.shape)), axis=1)
            kept = np.argpartition(near, CANDIDATES - 1, axis=1)[:, :CANDIDATES]
            self.near[some] = np.take_along_axis(near, kept, axis=1)
            self.candidates[some] = np.take_along_axis(candidates, kept, axis=1)

    def candidates_at(self, sequence: int, tempo: int) -> Int64[np.ndarray, "some"]:
        """Rows that have the sequence at this tempo as a candidate."""
        number = sequence * len(TEMPI) + tempo
        return np.flatnonzero(((self.candidates == number) & np.isfinite(self.near)).any(axis=1))

    def compare(self, rows: Int64[np.ndarray, "some"], sequence: int, tempo: int, track: Track) -> None:
        """Exact distances of rows to those stretches of a track that are the nearest on the components."""
        if not len(rows):
            return
        starts, whose = _Laid.joined([track]).starts(self.num_poses, POSE_EVERY)
        theirs = self.basis.project(track.stretches(starts, self.num_poses))
        for some in np.array_split(rows, -(-len(rows) // BLOCK_QUERIES)):
            near = _to_segments(self.components[some], theirs, whose)
            ours = self._stretches(some)
            for place in np.argsort(near, axis=1)[:, :PLACES].T:
                squared = _least_squares(ours, track, starts[place], self.num_poses)
                better = squared < self.best[some]
                self.best[some[better]] = squared[better]
                self.best_candidate[some[better]] = sequence * len(TEMPI) + tempo

    def found(self) -> Nearest:
        """The best of the four ways."""
        number = len(self.start)
        ways = self.best.reshape(len(WAYS), number)
        way = ways.argmin(axis=0)
        row = way * number + np.arange(number)
        sequence, tempo = np.divmod(self.best_candidate[row], len(TEMPI))
        mirrored, backwards = np.array(WAYS)[way].T
        movement = self.laid[0].track.stretches(self.start, self.num_poses).movement()
        return Nearest(
            seconds=self.seconds,
            motion=self.motion,
            start_seconds=(self.start - self.laid[0].first[self.motion]) / float(FPS),
            movement=movement,
            distance=np.sqrt(self.best[row]),
            sequence=sequence,
            tempo=np.array([float(each) for each in TEMPI])[tempo],
            mirrored=mirrored,
            backwards=backwards,
        )


def _flat(bones: Shaped[np.ndarray, "stretches poses bones"]) -> Shaped[np.ndarray, "stretches numbers"]:
    return bones.reshape(len(bones), bones.shape[1] * bones.shape[2])


def _parts(stretches: Stretches) -> tuple[npt.NDArray[np.generic], ...]:
    return stretches.planar, stretches.upright, stretches.turn


def _num_poses(seconds: float) -> int:
    return round(seconds * float(FPS) / POSE_EVERY)


def _to_segments(
    queries: Float32[np.ndarray, "queries components"],
    rows: Float32[np.ndarray, "rows components"],
    whose: Int64[np.ndarray, "rows"],
) -> Float32[np.ndarray, "queries rows"]:
    """Squared distance to the segment from each row to the next of the same sequence, less the query's squared length.

    |q − r|² − |q|² by one matrix product; a query's own length doesn't change which is nearest.
    """
    following = np.append(np.where(whose[1:] == whose[:-1], np.arange(1, len(rows)), np.arange(len(rows) - 1)), -1)
    step = np.einsum("rc,rc->r", rows[following] - rows, rows[following] - rows) + TINY
    here: Float32[np.ndarray, "queries rows"] = queries @ rows.T
    here *= -2.0
    here += np.einsum("rc,rc->r", rows, rows)
    ahead = here - here[:, following] + step
    share = np.clip(ahead / (2 * step), 0, 1)
    ahead -= share * step
    here -= share * ahead
    return here


def _least_squares(
    ours: Stretches, track: Track, start: Int64[np.ndarray, "ours"], num_poses: int
) -> Float64[np.ndarray, "ours"]:
    """Mean square difference of bones to the stretch of a track from a frame, one of the next two or between them on.

    Each pair is turned about the vertical as it fits best; from one frame to the next motion is taken to be linear.
    """
    planar, upright = _flat(ours.planar), _flat(ours.upright)

    def missing(first: Int64[np.ndarray, "ours"]) -> Float32[np.ndarray, "ours numbers"]:
        theirs = track.stretches(first, num_poses)
        turned = _flat(theirs.planar)
        overlap = np.einsum("qn,qn->q", planar.conj(), turned)
        size = np.abs(overlap)
        turned *= np.where(size > 0, overlap.conj() / np.where(size > 0, size, 1), 1)[:, None].astype(np.complex64)
        turned -= planar
        return np.concatenate((turned.real, turned.imag, _flat(theirs.upright) - upright), axis=1)

    last = len(track.facing) - POSE_EVERY * (num_poses - 1) - 1
    middle = np.minimum(start + 1, last)
    at = missing(middle)
    found = np.einsum("qn,qn->q", at, at, dtype=np.float64)
    for beside in (start, np.minimum(start + 2, last)):
        step = missing(beside) - at
        long = np.einsum("qn,qn->q", step, step, dtype=np.float64)
        along = -np.einsum("qn,qn->q", at, step, dtype=np.float64)
        between = at + np.clip(along / (long + TINY), 0, 1).astype(np.float32)[:, None] * step
        found = np.minimum(found, np.einsum("qn,qn->q", between, between, dtype=np.float64))
    return np.asarray(found / (ours.planar.shape[1] * ours.planar.shape[2]))
