"""Is a generated motion a copy? How far the middle of each motion is from the nearest stretch of training motion.

A stretch is 2 s of body poses at 10 fps: joints relative to the root, turned to face Z+ at every instant, so that a
copy is found wherever it stands, whichever way it faces and whenever it begins (training stretches start every 0.1 s).
The nearest one has the least root mean square joint distance; the figure is the mean distance of its joints, the root
not counted. Only beside the same figure of held-out real motion does it mean anything.
"""

from collections.abc import Iterator, Mapping
from fractions import Fraction

import numpy as np
from jaxtyping import Float, Float32, Float64
from threadpoolctl import threadpool_limits

from eval.metrics.gaussian import fit_gaussian, frechet_distance
from eval.metrics.neighbours import nearest_rows
from eval.sets.sets import SampleSet
from motionkit.features import field

SAMPLED_FPS = Fraction(20)
EVERY = 2
"""Every second pose of a set at 20 fps: 10 poses a second."""
STRETCH_POSES = 20
STRETCH_SECONDS = 2.0
BLOCK_STRETCHES = 4096


def distances_to_training(samples: SampleSet, training: SampleSet) -> Float64[np.ndarray, "motions"]:
    """Mean joint distance in metres from the middle 2 s of each motion to the nearest 2 s of training motion.

    Motions and training sequences shorter than that are left out, so there may be fewer distances than motions. Both
    sets are at 20 fps; raises `ValueError` for others, and where no training sequence is long enough.
    """
    for each in (samples, training):
        if each.fps != SAMPLED_FPS:
            raise ValueError(f"{each.name} is at {each.fps} fps, not at {SAMPLED_FPS}")
    middles = [_middle(poses) for poses in map(_body_poses, samples.sequences) if len(poses) >= STRETCH_POSES]
    if not middles:
        return np.zeros(0)
    queries = np.stack(middles)
    difference = nearest_rows(queries, _stretches(training)).astype(np.float64) - queries
    return np.asarray(np.linalg.norm(difference.reshape(len(queries), -1, 3), axis=-1).mean(axis=1))


def _body_poses(positions: Float32[np.ndarray, "frames joints 3"]) -> Float32[np.ndarray, "poses numbers"]:
    """Joints 1 … J − 1 relative to the root, each pose facing Z+, 10 poses a second."""
    poses = positions[::EVERY]
    yaw, origin = field.window_frame(poses)
    return field.encode(poses[:, None], yaw, origin)[:, 0, 3:]


def _middle(poses: Float32[np.ndarray, "poses numbers"]) -> Float32[np.ndarray, "stretch"]:
    first = (len(poses) - STRETCH_POSES) // 2
    return poses[first : first + STRETCH_POSES].reshape(-1)


def _stretches(training: SampleSet) -> Iterator[Float32[np.ndarray, "_ stretch"]]:
    """All stretches of all sequences, a block at a time."""
    for poses in map(_body_poses, training.sequences):
        last = len(poses) - STRETCH_POSES
        for start in range(0, last + 1, BLOCK_STRETCHES):
            part = poses[start : min(start + BLOCK_STRETCHES, last + 1) + STRETCH_POSES - 1]
            windows = np.lib.stride_tricks.sliding_window_view(part, STRETCH_POSES, axis=0)
            yield np.ascontiguousarray(windows.transpose(0, 2, 1)).reshape(len(windows), -1)


CHOICES = 10
SAME = 1e-6
"""Of the spread of the real features: embeddings of one motion differ by far less, those of two by far more."""

Features = Float[np.ndarray, "_samples features"]


def size_remarks(real: Features, reference: Features, other: Features, seed: int) -> list[str]:
    """Sentences about motions that are real ones, and about what it costs to be fewer than the reference.

    `reference` are those of the real motions that FID compares with. The second sentence has the FID that as many
    random motions of the reference have from all of it: its mean, and the range of ten choices.
    """
    remarks = []
    copies = num_copies(real, other)
    if copies:
        remarks.append(
            f"{copies:,} of {len(other):,} motions are real motions of this set, which says nothing of a model"
        )
    if len(other) < len(reference):
        rng = np.random.default_rng((seed, 9))
        with threadpool_limits(1, "blas"):
            whole = fit_gaussian(reference)
            chosen = [rng.choice(len(reference), size=len(other), replace=False) for _ in range(CHOICES)]
            fids = [frechet_distance(whole, fit_gaussian(reference[rows])) for rows in chosen]
        remarks.append(
            f"as many random real motions ({len(other):,}) have an FID of {np.mean(fids):.3g} from all "
            f"({min(fids):.3g} to {max(fids):.3g} in {CHOICES} choices)"
        )
    return remarks


def num_copies(real: Features, other: Features) -> int:
    """How many rows are some row of the real features, to rounding."""
    tolerance = SAME * float(real.std())
    order = np.argsort(real[:, 0], kind="stable")
    first = real[order, 0]
    low, high = (np.searchsorted(first, other[:, 0] + sign * tolerance) for sign in (-1, 1))
    return sum(
        bool((np.abs(real[order[start:stop]] - row) <= tolerance).all(axis=1).any())
        for row, start, stop in zip(other, low.tolist(), high.tolist(), strict=True)
    )


SAME_METRES = 1e-5
STILL_METRES = 1e-6


def set_remarks(real: SampleSet, rows: Mapping[str, SampleSet]) -> list[str]:
    """One sentence for each row that holds sequences of the real set, or in which nothing moves."""
    remarks = []
    for name, samples in rows.items():
        copies = _num_copied_sequences(real, samples)
        if copies:
            remarks.append(
                f"{name}, {real.fps} fps: {copies} of {samples.num_sequences} sequences are copies of sequences of "
                f"{real.name}; a set of nothing else scores like independent draws (P1), which says nothing of a model"
            )
        if _is_still(samples):
            remarks.append(
                f"{name}, {real.fps} fps: nothing moves in any of the {samples.num_sequences} sequences; features of "
                "speed and acceleration are constant, and their part of the score is the real set's own spread"
            )
    return remarks


def _num_copied_sequences(real: SampleSet, samples: SampleSet) -> int:
    """How many sequences are some sequence of the real set, to rounding."""
    known: dict[int, list[Float32[np.ndarray, "_ joints 3"]]] = {}
    for sequence in real.sequences:
        known.setdefault(len(sequence), []).append(sequence)
    return sum(
        any(_same(sequence[0], other[0]) and _same(sequence, other) for other in known.get(len(sequence), ()))
        for sequence in samples.sequences
    )


def _same(a: Float32[np.ndarray, "*shape"], b: Float32[np.ndarray, "*shape"]) -> bool:
    return bool(np.abs(a - b).max() < SAME_METRES)


def _is_still(samples: SampleSet) -> bool:
    """Whether no joint moves from any frame to the next of the same sequence."""
    positions = samples.sequences.values
    steps = np.abs(np.diff(positions, axis=0)).reshape(max(len(positions) - 1, 0), -1)
    inside = np.ones(len(steps), dtype=bool)
    inside[samples.sequences.start_row[1:] - 1] = False
    return bool((steps[inside] < STILL_METRES).all())
