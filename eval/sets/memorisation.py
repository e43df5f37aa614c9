"""Detection of motions copied from training motion; remarks on sets with real motions or without movement.

A stretch is copied if its nearest training stretch (`copies`) is nearer, relative to its movement, than those of
held-out takes of the same store; a motion is accused if enough of its moving stretches are. Stretches that hardly move
are near everything and are ignored.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from eval.metrics.gaussian import fit_gaussian, frechet_distance
from eval.sets.copies import Nearest, TrainingMotion, nearest_training
from eval.sets.real import NoRealMotionError, real_motion
from eval.sets.sets import SampleSet
from eval.sets.stretches import FPS
from motionkit.core.errors import DamagedFileError, UsageError
from motionkit.core.files import read_json, write_json
from motionkit.core.progress import warn
from motionkit.core.shapes import Bool, Float, Float32, Float64, Int64
from motionkit.store.cache import cache_root

if TYPE_CHECKING:
    from motionkit.store.reader import Store

STILL_BONES = 0.03
"""Minimum movement of a stretch, the bones' RMS deviation from their means in metres; others are ignored."""
# No training take of CMU is as near to another: docs/results/memorisation.md.
SHARES = {0.5: 0.075, 1.0: 0.085, 2.0: 0.095}
"""Fractions of the movement, by seconds of a stretch: stretches farther from training motion are never copied."""
ACCUSED_SHARE = 0.25
"""Fraction of a motion's moving stretches of one length; a motion with more copied ones is accused."""
ACCUSED_HELD_OUT = 0.01
"""The fraction of held-out motions that a store's limits accuse."""
LEAST_FACTOR = 0.5
"""Fraction of the shares; anything nearer is copied in every store, even held-out motion."""
FEWEST_HELD_OUT, MOST_HELD_OUT = 50, 200
LIMITS_VERSION = 1
"""Raised when a store's limits change: a change of the search, or of the constants above."""


@dataclass(frozen=True)
class Limits:
    """Maximum distance of copied stretches: `factor` times the share of their movement in `SHARES`.

    The factor was estimated from `num_motions` motions, named by `found_from`.
    """

    factor: float = 1.0
    num_motions: int = 0
    found_from: str = "no held-out motion"

    def __str__(self) -> str:
        shares = ", ".join(f"{self.factor * share:.3f}" for share in SHARES.values())
        lengths = ", ".join(f"{seconds:g}" for seconds in SHARES)
        return f"{shares} of the movement ({lengths} s), found from {self.num_motions} {self.found_from}"


@dataclass(frozen=True, eq=False)
class Verdicts:
    """Per motion: number of moving stretches of each length, the copied fraction of them, and whether it is accused.

    A motion without moving stretches is not `decidable`; its shares are 0.
    """

    num_moving: Mapping[float, Int64[np.ndarray, "motions"]]
    copied_share: Mapping[float, Float64[np.ndarray, "motions"]]
    decidable: Bool[np.ndarray, "motions"]
    accused: Bool[np.ndarray, "motions"]


def moving(nearest: Nearest) -> Bool[np.ndarray, "stretches"]:
    """Stretches that move enough to be distinctive."""
    return np.asarray(nearest.movement >= STILL_BONES)


def copied(nearest: Nearest, limits: Limits) -> Bool[np.ndarray, "stretches"]:
    """Moving stretches that are nearer to training motion than the limits."""
    return moving(nearest) & (_factors(nearest) < limits.factor)


def _factors(nearest: Nearest) -> Float64[np.ndarray, "stretches"]:
    """The distance divided by the share of the movement; for still stretches, of the minimum movement."""
    return np.asarray(nearest.distance / (SHARES[nearest.seconds] * np.maximum(nearest.movement, STILL_BONES)))


def verdicts(found: Sequence[Nearest], num_motions: int, limits: Limits) -> Verdicts:
    """Verdicts on motions from their stretches of 0.5, 1 and 2 s, as `copies.nearest_training` returns them."""
    numbers, shares = {}, {}
    for nearest in found:
        number = np.bincount(nearest.motion[moving(nearest)], minlength=num_motions)
        hits = np.bincount(nearest.motion[copied(nearest, limits)], minlength=num_motions)
        numbers[nearest.seconds] = number
        shares[nearest.seconds] = hits / np.maximum(number, 1)
    decidable = np.any([number > 0 for number in numbers.values()] or np.zeros((1, num_motions), bool), axis=0)
    accused = np.any([share > ACCUSED_SHARE for share in shares.values()] or np.zeros((1, num_motions), bool), axis=0)
    return Verdicts(numbers, shares, decidable, accused)


def least_factors(found: Sequence[Nearest], num_motions: int) -> Float64[np.ndarray, "motions"]:
    """The largest factor that does not accuse each motion; infinite if it is not decidable."""
    least = np.full(num_motions, np.inf)
    for nearest in found:
        some = moving(nearest)
        factors = _factors(nearest)[some]
        order = np.lexsort((factors, nearest.motion[some]))
        numbers = np.bincount(nearest.motion[some], minlength=num_motions)
        held = np.flatnonzero(numbers)
        place = (np.cumsum(numbers) - numbers + np.floor(ACCUSED_SHARE * numbers).astype(np.int64))[held]
        least[held] = np.minimum(least[held], factors[order][place])
    return least


def limits_from(found: Sequence[Nearest], num_motions: int, found_from: str) -> Limits:
    """The widest limits that accuse at most 1 % of held-out motions, never beyond `SHARES` or under half of them.

    The upper bound matters if held-out motion is far from all training motion, the lower one if it contains training
    motion.
    """
    least = np.sort(least_factors(found, num_motions))
    least = least[np.isfinite(least)]
    if not len(least):
        return Limits()
    factor = least[int(ACCUSED_HELD_OUT * len(least))]
    return Limits(float(np.clip(factor, LEAST_FACTOR, 1.0)), len(least), found_from)


def limits_of(training: SampleSet, indexed: TrainingMotion, validation: SampleSet | None) -> Limits:
    """A store's limits, from validation motion; if there is too little, from training motions each against all others.

    At most 200 random motions of either are used; fewer than 50 validation motions are too few if there are more for
    training.
    """
    rng = np.random.default_rng(0)
    if validation is not None and validation.num_sequences >= min(FEWEST_HELD_OUT, training.num_sequences):
        chosen = np.sort(rng.permutation(validation.num_sequences)[:MOST_HELD_OUT])
        found = nearest_training(validation.select(chosen), indexed)
        return limits_from(found, len(chosen), "validation motions")
    chosen = np.sort(rng.permutation(training.num_sequences)[:MOST_HELD_OUT])
    apart = chosen[:, None] == np.arange(training.num_sequences)
    found = nearest_training(training.select(chosen), indexed, apart)
    return limits_from(found, len(chosen), "training motions, each beside all others")


def limits_of_store(
    store: "Store", training: SampleSet, indexed: TrainingMotion, *, with_validation: bool = True
) -> Limits:
    """`limits_of` a store's training split, from its validation split if allowed; cached beside the training caches.

    The cached limits are used until the store changes; a damaged file is replaced with a warning.
    """
    key = {"version": LIMITS_VERSION, "store": store.fingerprint}
    name = "copy-limits.json" if with_validation else "copy-limits-without-validation.json"
    path = cache_root(store.path, store.fingerprint) / name
    if path.is_file():
        try:
            document = read_json(path, "the limits are computed anew")
            if document["key"] == key:
                return Limits(**document["limits"])
        except DamagedFileError as error:
            warn(str(error))
    limits = limits_of(training, indexed, _validation(store) if with_validation else None)
    with suppress(OSError):  # a store may be read-only
        write_json(path, {"key": key, "limits": asdict(limits)})
    return limits


def _validation(store: "Store") -> SampleSet | None:
    try:
        return real_motion(store, "val").at(FPS)
    except (UsageError, NoRealMotionError):
        return None


CHOICES = 10
SAME = 1e-6
"""Fraction of the real features' spread: embeddings of one motion differ by far less, those of two by far more."""

Features = Float[np.ndarray, "_samples features"]


def size_remarks(real: Features, reference: Features, other: Features, seed: int) -> list[str]:
    """Remarks on motions that are real ones, and on the FID of sets smaller than the reference.

    `reference` are those of the real motions that FID compares with. The second remark has the FID of equally many
    random motions of the reference against all of it: its mean, and the range of ten draws.
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
    """Number of rows that equal a row of the real features, up to rounding."""
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
    """One remark for each row that holds sequences of the real set, or in which nothing moves."""
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
    """Number of sequences that equal a sequence of the real set, up to rounding."""
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
