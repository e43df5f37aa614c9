"""Motions as sample sets: real at a framerate, generated for them, planted, upsampled, low-passed; and copies."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from math import ceil

import numpy as np
import numpy.typing as npt
import scipy.fft

from eval.sets.sets import Ragged, RowId, SampleSet, Variant, sample_set
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.motion import Motion, mirror_positions
from motionkit.core.shapes import Float, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22, STANDARD_SKELETONS
from motionkit.core.timegrid import TimeGrid
from motionkit.features import humanml3d
from motionkit.features.field import heading, to_window
from motionkit.features.humanml3d import at_origin, facing_forward, on_floor
from motionkit.fields.contact.planted import planted, planted_frames
from motionkit.fields.interpolation import InterpolatedField
from motionkit.fields.motion_field import DerivedField, MotionField, Observation, Poses, at_fps, to_motion
from motionkit.fields.resample import resample_positions, upsample
from motionkit.generate.models import ChecksRequests, GenerationRequest, GenerativeModel, SamplingOptions
from motionkit.store.cache import open_cache
from motionkit.store.reader import Store, conjunction


class NoRealMotionError(MotionkitError):
    """A store without real motion at the requested framerate."""


@dataclass(eq=False)
class RealMotion:
    """Sequences at their native framerates; `at` resamples them once per framerate and keeps the result.

    They have 22 joints or KIT-ML's 21; sequence i is at fps[i].
    """

    name: str
    sequences: Ragged
    fps: tuple[Fraction, ...]
    sequence_ids: tuple[str, ...]
    captions: tuple[str, ...]
    actions: tuple[str, ...]
    _sampled: dict[tuple[Fraction, int], SampleSet] = field(default_factory=dict)

    def indices_at(self, fps: Fraction, first_frame: int = 0) -> npt.NDArray[np.int64]:
        """Sequences whose native framerate is at least `fps`, with at least two frames after the first ones.

        Raises `NoRealMotionError` for fewer than two sequences.
        """
        lengths = self.sequences.num_frames
        chosen = [i for i, native in enumerate(self.fps) if native >= fps and lengths[i] > first_frame + 1]
        if len(chosen) < 2:
            fastest = f"; the fastest has {float(max(self.fps)):.6g} fps" if self.fps else ""
            raise NoRealMotionError(
                f"{self.name}: {len(chosen)} of {len(self.fps)} sequences were captured at {float(fps):.6g} fps or "
                f"faster, at least two are needed{fastest}: choose framerates with --fps, or hold out more takes "
                "(motionkit split --shares train=0.7,test=0.3, with --by sequence_id where no performer is named)"
            )
        return np.array(chosen, dtype=np.int64)

    def at(self, fps: Fraction, first_frame: int = 0) -> SampleSet:
        """Every sequence of native rate ≥ fps at exactly fps, anti-aliased; slower ones are left out.

        `first_frame` drops that many native frames first, which shifts the grid. Raises `NoRealMotionError` where
        fewer than two sequences remain.
        """
        key = (fps, first_frame)
        if key not in self._sampled:
            chosen = self.indices_at(fps, first_frame).tolist()
            self._sampled[key] = sample_set(
                self.name,
                fps,
                [resample_positions(self.sequences[index][first_frame:], self.fps[index], fps) for index in chosen],
                [self.sequence_ids[index] for index in chosen],
                [self.captions[index] for index in chosen],
                [self.actions[index] for index in chosen],
            )
        return self._sampled[key]

    def forget_all_but(self, fps: Fraction) -> None:
        """Drop cached sets of other framerates; `at` computes them again."""
        for key in [key for key in self._sampled if key[0] != fps]:
            del self._sampled[key]


def of_split_and(split: str, where: str | None) -> str | None:
    """The SQL condition for the sequences of a split ("all": any) that match `where` too; None for all."""
    quoted = split.replace("'", "''")
    return conjunction(None if split == "all" else f"split = '{quoted}'", where) or None


def real_motion(store: Store, split: str, where: str | None = None, layout: str = SMPL22.name) -> RealMotion:
    """The sequences of one split of a store ("all": every one) for which `where` (SQL) holds, in a joint layout.

    A sequence's caption is its first. Raises `UsageError` if the split is empty or its skeletons cannot be mapped.
    """
    cache = open_cache(store, layout=layout, where=of_split_and(split, where))
    table = store.columns("sequence_id", "captions", "action").loc[cache.sequence_index]
    return RealMotion(
        name=f"real ({split})",
        sequences=Ragged(cache.positions, cache.start_row.astype(np.int64), cache.num_frames.astype(np.int64)),
        fps=tuple(map(cache.exact_fps, range(len(table)))),
        sequence_ids=tuple(table["sequence_id"].astype(str)),
        captions=tuple(str(captions[0]["text"]) if len(captions) else "" for captions in table["captions"]),
        actions=tuple(table["action"].astype(str)),
    )


def has_training(store: Store) -> bool:
    """Whether a store has a training split."""
    return bool((store.columns("split")["split"] == "train").any())


def training_motion(store: Store, compared: RealMotion) -> RealMotion:
    """The set to fit features on: the training split, or the compared sequences without one."""
    return real_motion(store, "train") if has_training(store) else compared


AT_ONCE = 256
Joints = Float32[np.ndarray, "_frames _joints 3"]


@dataclass(frozen=True)
class Window:
    """A window of one real sequence for which a motion is generated; `number` counts the sequence's windows from 0.

    `draw` counts generations of the same window, each with a seed of its own.
    """

    sequence_id: str
    number: int
    request: GenerationRequest
    draw: int = 0


def windows_of(real: SampleSet, max_duration_seconds: float) -> list[Window]:
    """Requests with the captions, actions and durations of a real set; the model uses those it was trained with.

    A sequence longer than the model supports becomes several windows of equal length with its caption, so that a
    caption's share of the generated seconds is its share of the real ones.
    """
    windows: list[Window] = []
    for index in range(real.num_sequences):
        duration = float((int(real.sequences.num_frames[index]) - 1) / real.fps)
        count = max(1, ceil(duration / max_duration_seconds - 1e-9))
        request = GenerationRequest(duration / count, real.captions[index], real.actions[index])
        windows.extend(Window(real.sequence_ids[index], number, request) for number in range(count))
    return windows


def is_unconditional(model: GenerativeModel) -> bool:
    """Whether a model declares by an attribute `unconditional` that it was trained without texts and actions."""
    return bool(getattr(model, "unconditional", False))


def needs_a_condition(model: GenerativeModel) -> bool:
    """Whether a model declares by an attribute `always_conditioned` that it was never trained without one."""
    return bool(getattr(model, "always_conditioned", False))


def refusal(model: GenerativeModel, request: GenerationRequest) -> str:
    """Why a model with a `check` refuses a request; empty if it does not."""
    if isinstance(model, ChecksRequests):
        try:
            model.check(request)
        except UsageError as error:
            return str(error)
    return ""


def as_known(model: GenerativeModel, requests: Sequence[GenerationRequest]) -> list[GenerationRequest]:
    """Requests as a model knows them: the durations alone for one without conditions."""
    if is_unconditional(model):
        return [GenerationRequest(request.duration_seconds) for request in requests]
    return list(requests)


def generate_fields(
    model: GenerativeModel,
    windows: Sequence[Window],
    seed: int,
    limit: int,
    sampling: SamplingOptions = SamplingOptions(),
    draws: int = 1,
    on_motions: Callable[[int], None] = lambda count: None,
) -> dict[Window, MotionField]:
    """A motion field per window and draw, or for a random subset of `limit` windows.

    An unconditional model gets the windows' durations alone. `on_motions` is called after each `AT_ONCE` motions.
    """
    chosen = list(windows)
    if len(windows) > limit:
        picked = np.random.default_rng((seed, 7)).choice(len(windows), size=limit, replace=False)
        chosen = [windows[index] for index in np.sort(picked).tolist()]
    requests = as_known(model, [window.request for window in chosen])
    generated: dict[Window, MotionField] = {}
    for draw in range(draws):
        for first in range(0, len(requests), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            fields = model.generate(requests[some], seed=seed + draw, sampling=sampling, first=first)
            generated |= zip((replace(window, draw=draw) for window in chosen[some]), fields, strict=True)
            on_motions(len(fields))
    return generated


def remembering(field: MotionField) -> DerivedField:
    """The field with the poses of its last two queries: several rows are sampled at the same instants."""
    query: Callable[[bytes], Poses] = lru_cache(2)(lambda times: field.query(np.frombuffer(times)))
    derived: Callable[[Fraction], DerivedField] = lru_cache(2)(lambda fps: remembering(at_fps(field, fps)))
    return DerivedField(field, lambda times: query(times.tobytes()), derived)


def is_framed(fields: Mapping[Window, MotionField]) -> bool:
    """Whether a model generates frames at its own framerate, with interpolation in between."""
    return all(isinstance(field, InterpolatedField) for field in fields.values())


def sample_fields(
    fields: Mapping[Window, MotionField], sequence_ids: Sequence[str], fps: Fraction, name: str
) -> SampleSet | None:
    """Fields of the given sequences' windows, sampled at exactly fps; None where there are none.

    Nothing is resampled: the field is queried at every instant. The take of a motion is the sequence it is for.
    """
    known = set(sequence_ids)
    windows = [window for window in fields if window.sequence_id in known]
    if not windows:
        return None
    draws = tuple(window.draw for window in windows)
    return SampleSet(
        name,
        fps,
        Ragged.of([to_motion(fields[window], fps).joint_positions for window in windows]),
        tuple(f"{each.sequence_id}#{each.number}" + (f"@{each.draw}" if each.draw else "") for each in windows),
        captions=tuple(window.request.text for window in windows),
        actions=tuple(window.request.action for window in windows),
        takes=tuple(window.sequence_id for window in windows),
        generations=draws if any(draws) else (),
    )


VARIANT_NOTES = {
    Variant.PLANTED: "the same motions with feet that stand, on bones of one length (docs/plant.md)",
    Variant.DETAILED: "the planted motions with what captures hold above 10 Hz, drawn anew (docs/detail.md)",
}
"""Tables' notes for rows of planted motion."""


def planted_fields(fields: Mapping[Window, MotionField]) -> dict[Window, MotionField]:
    """Planted generated motion fields, as `motionkit generate` writes them."""
    return {window: planted(field, "free") for window, field in fields.items()}


def planted_set(samples: SampleSet) -> SampleSet:
    """A set's motions planted, as `motionkit plant --path free` writes them; without rotations."""
    joints = samples.sequences.values.shape[1]
    skeleton = next(each for each in STANDARD_SKELETONS.values() if each.num_joints == joints)
    planted_positions = []
    for positions in samples.sequences:
        # Not from_joints, which refuses bodies of no person's size: a model may generate such.
        motion = Motion(positions, skeleton, TimeGrid(samples.fps, len(positions)))
        planting = planted_frames(Observation.of(motion), motion.timegrid, "free")
        planted_positions.append(planting(motion.timegrid.seconds()).joint_positions)
    name = str(RowId(samples.name, Variant.PLANTED))
    return replace(samples, name=name, sequences=Ragged.of(planted_positions), local_rotations=None)


def upsampled(samples: SampleSet, fps: Fraction, name: str) -> SampleSet:
    """Upsample every sequence by SLERP; ids are kept, for comparison with the real sequences.

    Joint rotations (from inverse kinematics) on great arcs, the root on straight lines, positions by forward
    kinematics. Raises `ValueError` if `fps` is below the set's.
    """
    sequences = [upsampled_positions(sequence, samples.fps, fps) for sequence in samples.sequences]
    return samples.with_positions(sequences, name=name, fps=fps)


def upsampled_positions(positions: Joints, fps_from: Fraction, fps_to: Fraction) -> Joints:
    """Joint positions of the 22-joint layout at a higher framerate; raises `ValueError` for a lower one."""
    return upsample(Motion(positions, SMPL22, TimeGrid(fps_from, len(positions))), fps_to).joint_positions


def at_framerate(positions: Joints, fps_from: Fraction, fps_to: Fraction) -> Joints:
    """Joint positions of the 22-joint layout at another framerate: upsampled by SLERP, or anti-aliased."""
    return (upsampled_positions if fps_from < fps_to else resample_positions)(positions, fps_from, fps_to)


def upsample_as_vectors(samples: SampleSet, fps: Fraction, name: str) -> SampleSet:
    """HumanML3D vectors interpolated linearly, their per-frame root velocities left as they are, then recovered.

    The root's path and turns grow by the upsampling factor: a flaw of the procedure, not of the motion. It would
    explain how published baselines grow with the framerate, and is shown beside SLERP for that reason only.
    """
    sequences = []
    for positions in samples.sequences:
        vectors = humanml3d.vectors(facing_forward(at_origin(on_floor(positions)), SMPL22.name), SMPL22.name)
        place = np.arange(int((len(vectors) - 1) * (fps / samples.fps)) + 1) * float(samples.fps / fps)
        below = np.minimum(place.astype(np.int64), len(vectors) - 1)
        above = np.minimum(below + 1, len(vectors) - 1)
        fraction = (place - below)[:, None]
        mixed = (1.0 - fraction) * vectors[below] + fraction * vectors[above]
        sequences.append(humanml3d.positions(mixed.astype(np.float32), SMPL22.name))
    return samples.with_positions(sequences, name=name, fps=fps)


def low_pass(
    positions: Float[np.ndarray, "frames joints 3"], fps: float, cutoff_hz: float
) -> Float[np.ndarray, "frames joints 3"]:
    """Zero-phase Butterworth low-pass along time, half amplitude at the cut-off.

    The gain 1 / (1 + (f / cut-off)^8) is that of a Butterworth filter of order 4 run forwards and backwards.
    """
    return filtered(positions, lambda f: 1.0 / (1.0 + (f * fps / cutoff_hz) ** 8))


def filtered(
    positions: Float[np.ndarray, "frames joints 3"],
    gain: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.floating | np.complexfloating]],
    delay: float = 0.0,
) -> Float[np.ndarray, "frames joints 3"]:
    """Motion with its spectrum along frames multiplied by gain(cycles per frame) [frequencies].

    The ends are continued by point reflection, so that constant motion and constant velocity pass unchanged. `delay`
    says how many frames the gain moves a motion, for the trend, which has no spectrum.
    """
    num_frames = len(positions)
    if num_frames < 2:
        return positions.copy()
    motion = positions.astype(np.float64)
    padded = np.concatenate((2 * motion[:1] - motion[:0:-1], motion, 2 * motion[-1:] - motion[-2::-1]))
    # After the reflection a step remains between both ends of the padded motion: remove the linear trend.
    length = len(padded)
    slope = (padded[-1] - padded[0]) / (length - 1)
    line = padded[:1] + np.arange(length)[:, None, None] * slope
    spectrum = scipy.fft.rfft(padded - line, axis=0)
    spectrum *= gain(scipy.fft.rfftfreq(length))[:, None, None]
    smooth = scipy.fft.irfft(spectrum, n=length, axis=0) + line + delay * slope
    return np.asarray(smooth[num_frames - 1 : 2 * num_frames - 1], dtype=positions.dtype)


COPIES_FPS = Fraction(20)
SMOOTH_HZ = 5.0
POSES = np.arange(0, 21, 2)
"""Frames of a window of a second that are compared."""
NUM_BONES_COMPARED = len(POSES) * (SMPL22.num_joints - 1)
QUERY_EVERY, TRAINING_EVERY = 5, 1
TEMPI = (Fraction(4, 5), Fraction(9, 10), Fraction(1), Fraction(10, 9), Fraction(5, 4))
NUM_COMPONENTS = 48
BASIS_WINDOWS = 2048
QUERIES_AT_ONCE = 512
STILL_METRES = 0.03
"""Windows that move less are near everything: the root mean square deviation of bones from their means."""
PARENTS = np.array(SMPL22.parents[1:])


@dataclass(frozen=True, eq=False)
class Nearest:
    """Every moving window of a set: its motion, its distance to training motion in metres, and as a share of movement.

    The distance is the root mean square difference of bones, movement their deviation from their means.
    """

    motion: Int64[np.ndarray, "windows"]
    distance: Float64[np.ndarray, "windows"]
    relative: Float64[np.ndarray, "windows"]


@dataclass(frozen=True, eq=False)
class TrainingWindows:
    """All windows of training motion, among which copies are sought, whatever their body, tempo, side and place.

    Motions are compared at 20 fps, low-passed at 5 Hz, as the bones of one reference body. A window is a second, turned
    to face Z+ at its middle, held as principal components and the length of what these leave: distances of such values
    are at most those of the windows, and equal them for copies.
    """

    mean: Float32[np.ndarray, "numbers"]
    components: Float32[np.ndarray, "numbers components"]
    values: Float32[np.ndarray, "windows values"]

    @classmethod
    def of(cls, training: SampleSet) -> "TrainingWindows":
        """Raises `ValueError` if no motion lasts a second."""
        rows = np.concatenate([_bone_windows(_slow(each, training.fps), TRAINING_EVERY) for each in training.sequences])
        if not len(rows):
            raise ValueError("no training motion lasts a second")
        some = rows[:: -(-len(rows) // BASIS_WINDOWS)]
        mean = some.mean(axis=0)
        components = np.linalg.svd(some - mean, full_matrices=False)[2][:NUM_COMPONENTS].T
        return cls(mean, components, _projected(rows - mean, components))

    def nearest(self, samples: SampleSet) -> Nearest:
        """The nearest training window to every moving window of a set, as it is and mirrored, at tempi of 0.8 to 1.25.

        Windows are a quarter of a second apart.
        """
        motion, distance, relative = [np.empty(0, np.int64)], [np.empty(0)], [np.empty(0)]
        for number, positions in enumerate(samples.sequences):
            windows = []
            for tempo in TEMPI:
                slow = _slow(positions, samples.fps * tempo)
                mirrored = mirror_positions(slow, SMPL22.left_right_pairs)
                windows += [_bone_windows(slow, QUERY_EVERY, tempo), _bone_windows(mirrored, QUERY_EVERY, tempo)]
            count = min(map(len, windows))
            own = windows[2 * TEMPI.index(Fraction(1))][:count].reshape(count, len(POSES), len(PARENTS) * 3)
            deviation = np.square(own - own.mean(axis=1, keepdims=True)).sum(axis=(1, 2))
            movement = np.sqrt(deviation / NUM_BONES_COMPARED)
            moving = movement >= STILL_METRES
            if moving.any():
                nearest = np.min([self._distance(each[:count][moving]) for each in windows], axis=0)
                motion.append(np.full(len(nearest), number))
                distance.append(nearest)
                relative.append(nearest / movement[moving])
        return Nearest(np.concatenate(motion), np.concatenate(distance), np.concatenate(relative))

    def _distance(self, windows: Float32[np.ndarray, "queries numbers"]) -> Float64[np.ndarray, "queries"]:
        """Root mean square difference of bones to the nearest training window."""
        values = _projected(windows - self.mean, self.components)
        squares, nearest = np.square(self.values).sum(axis=1), np.empty(len(windows))
        for first in range(0, len(windows), QUERIES_AT_ONCE):
            some = values[first : first + QUERIES_AT_ONCE]
            apart = squares - 2.0 * some @ self.values.T
            nearest[first : first + len(some)] = apart.min(axis=1) + np.square(some).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(nearest, 0.0) / NUM_BONES_COMPARED), dtype=np.float64)


def _projected(
    centred: Float32[np.ndarray, "windows numbers"], components: Float32[np.ndarray, "numbers components"]
) -> Float32[np.ndarray, "windows values"]:
    projected = centred @ components
    rest = np.square(centred).sum(axis=1) - np.square(projected).sum(axis=1)
    return np.column_stack((projected, np.sqrt(np.maximum(rest, 0.0)))).astype(np.float32)


def _slow(positions: Float32[np.ndarray, "_frames 22 3"], fps: Fraction) -> Float64[np.ndarray, "_slow_frames 22 3"]:
    """Joint positions at 20 fps below 5 Hz; a higher framerate than the motion's plays it faster."""
    return low_pass(resample_positions(positions, fps, COPIES_FPS).astype(np.float64), float(COPIES_FPS), SMOOTH_HZ)


def _bone_windows(
    positions: Float64[np.ndarray, "frames 22 3"], every: int, tempo: Fraction = Fraction(1)
) -> Float32[np.ndarray, "windows numbers"]:
    """Flat windows of bones, one every so many frames of the motion at its own tempo, turned to face Z+."""
    starts = np.arange(0, (len(positions) - POSES[-1] - 1) * float(tempo) + 1e-6, every) / float(tempo)
    frames = starts.round().astype(np.int64)[:, None] + POSES
    bones = positions[:, 1:] - positions[:, PARENTS]
    # Of the reference body, left and right alike, so that a mirrored copy has the same bones.
    lengths = np.linalg.norm(SMPL22.offsets, axis=-1)
    for pair in SMPL22.left_right_pairs:
        lengths[list(pair)] = lengths[list(pair)].mean()
    bones *= lengths[1:, None] / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-6)
    yaw = heading(positions)[frames[:, len(POSES) // 2]]
    turned = to_window(bones[frames], yaw, np.zeros((len(frames), 2)))
    return turned.reshape(len(frames), 3 * NUM_BONES_COMPARED)
