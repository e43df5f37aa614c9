"""Copies are found under every disguise, and nothing else is; stretches that stand still say nothing."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from eval.sets import copies, memorisation
from eval.sets.copies import Nearest, TrainingMotion, nearest_training
from eval.sets.corruptions import jitter, low_pass, upsample_slerp
from eval.sets.memorisation import (
    SHARES,
    Limits,
    Verdicts,
    copied,
    least_factors,
    limits_from,
    limits_of,
    moving,
    verdicts,
)
from eval.sets.real import real_motion
from eval.sets.row_ids import RowId
from eval.sets.sets import SampleSet, sample_set
from eval.sets.stretches import BONE_LENGTHS, Track
from eval.tables.nerm.copies import ACCUSED, COPIED, HELD_OUT, copies_block
from motionkit.core.errors import MotionkitWarning
from motionkit.core.mirror import mirror_positions
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.resample import resample_positions
from motionkit.store import Store, StoreWriter

FPS = Fraction(60)


def swinging(seed: int, seconds: float, fps: Fraction = FPS) -> np.ndarray:
    """A body whose joints swing at frequencies of their own, as it walks along."""
    rng = np.random.default_rng(seed)
    rest = np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    times = np.arange(round(seconds * fps))[:, None, None] / float(fps)
    rate, phase = rng.uniform(0.2, 2, (22, 3)), rng.uniform(0, 6, (22, 3))
    return (rest + 0.05 * np.sin(2 * np.pi * rate * times + phase) + np.array([0.3, 0, 0.4]) * times).astype(np.float32)


def as_set(*sequences: np.ndarray, fps: Fraction = FPS) -> SampleSet:
    found = [np.ascontiguousarray(each, dtype=np.float32) for each in sequences]
    return sample_set("some", fps, found, [str(index) for index in range(len(found))])


TRAINING = as_set(*(swinging(seed, seconds) for seed, seconds in enumerate((3.0, 1.0, 9.0, 4.0))))
LITTLE = as_set(swinging(0, 3.0))
TAKE = swinging(2, 9.0)[130:370]
BONES = 1 + 0.15 * np.sin(np.arange(22))


def elsewhere(positions: np.ndarray) -> np.ndarray:
    """Turned by 2 rad about the vertical and moved."""
    turn = np.array([[np.cos(2), 0, np.sin(2)], [0, 1, 0], [-np.sin(2), 0, np.cos(2)]])
    return (positions @ turn.T + np.array([5.0, 0.3, -2.0])).astype(np.float32)


def other_proportions(positions: np.ndarray) -> np.ndarray:
    made = positions.copy()
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        made[:, joint] = made[:, parent] + BONES[joint] * (positions[:, joint] - positions[:, parent])
    return made


def mirrored(positions: np.ndarray) -> np.ndarray:
    return mirror_positions(positions, SMPL22.left_right_pairs)


def played(positions: np.ndarray, tempo: str) -> np.ndarray:
    return resample_positions(positions, FPS * Fraction(tempo), FPS)


def noisy(positions: np.ndarray, metres: float) -> np.ndarray:
    return jitter(positions[None], float(FPS), metres, np.random.default_rng(0))[0]


DISGUISES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "none": lambda take: take,
    "elsewhere": elsewhere,
    "1.1 × taller": lambda take: take * np.float32(1.1),
    "other proportions": other_proportions,
    "0.8 × the tempo": lambda take: played(take, "0.8"),
    "1.07 × the tempo": lambda take: played(take, "1.07"),
    "1.25 × the tempo": lambda take: played(take, "1.25"),
    "mirrored": mirrored,
    "backwards": lambda take: take[::-1],
    "noise": lambda take: noisy(take, 0.003),
    "low-passed": lambda take: low_pass(take, float(FPS), 8.0),
    "from 20 fps": lambda take: upsample_slerp(take[None], float(FPS), 20.0, np.random.default_rng(0))[0],
    "spliced": lambda take: np.concatenate((take[:120], swinging(0, 3.0)[20:140])),
    "all at once": lambda take: noisy(elsewhere(mirrored(played(1.1 * take, "1.18")))[::-1], 0.001),
}


def near(samples: SampleSet, training: SampleSet, apart: np.ndarray | None = None) -> tuple[Nearest, ...]:
    return nearest_training(samples, TrainingMotion.of(training), apart)


def told_of(samples: SampleSet, training: SampleSet = TRAINING) -> Verdicts:
    return verdicts(near(samples, training), samples.num_sequences, Limits())


@pytest.mark.parametrize("name", list(DISGUISES))
def test_every_disguise_of_a_take_is_seen_through(name: str) -> None:
    assert told_of(as_set(DISGUISES[name](TAKE))).accused.all()


def test_fresh_motions_are_not_accused() -> None:
    told = told_of(as_set(*(swinging(seed, 4.0) for seed in range(30, 40))))
    assert told.decidable.all() and not told.accused.any()
    assert max(share.max() for share in told.copied_share.values()) == 0


@pytest.mark.parametrize("fps", ["12.5", "24", "30000/1001", "120"])
def test_copies_are_found_at_any_framerate(fps: str) -> None:
    rate = Fraction(fps)
    assert told_of(as_set(resample_positions(TAKE, FPS, rate), fps=rate)).accused.all()


def test_what_was_done_to_a_copy_is_said() -> None:
    for nearest in near(as_set(mirrored(played(TAKE, "1.25"))[::-1]), TRAINING):
        assert (nearest.sequence == 2).all() and nearest.mirrored.all() and nearest.backwards.all()
        np.testing.assert_allclose(nearest.tempo, 1.25)
        assert copied(nearest, Limits()).all()


def test_the_distance_of_a_bone_that_points_elsewhere() -> None:
    """The left hand turned from straight out to straight up in all of a training take that stands as it began."""
    rest = swinging(0, 3.0)
    still = np.repeat(rest[:1], 180, axis=0)
    other = still.copy()
    bone = other[:, 20] - other[:, 18]
    length = np.linalg.norm(bone, axis=-1)
    other[:, 20] = other[:, 18] + length[:, None] * np.array([0.0, 1.0, 0.0])
    between = np.linalg.norm(bone[0] / length[0] - np.array([0, 1, 0])) * BONE_LENGTHS[19, 0]
    # The training set holds this take alone, so that there is nothing else to be near to.
    for nearest in near(as_set(other), as_set(still)):
        np.testing.assert_allclose(nearest.distance, between / np.sqrt(21), rtol=0.02)
        np.testing.assert_allclose(nearest.movement, 0, atol=1e-6)


def test_stretches_that_stand_still_say_nothing() -> None:
    still = np.repeat(TAKE[:1], 200, axis=0)
    samples = as_set(still, TAKE)
    found = near(samples, as_set(np.repeat(TAKE[:1], 400, axis=0), TAKE))
    assert all(nearest.distance.max() < 1e-3 for nearest in found)
    assert [moving(nearest)[nearest.motion == 0].any() for nearest in found] == [False] * 3
    told = verdicts(found, 2, Limits())
    assert told.decidable.tolist() == [False, True] and told.accused.tolist() == [False, True]


def test_motions_apart_from_a_take_are_not_compared_with_it() -> None:
    samples = as_set(TAKE)
    own, others = (near(samples, TRAINING, np.arange(4)[None] == number) for number in (1, 2))
    assert all((nearest.sequence == 2).all() for nearest in own)
    assert not any((nearest.sequence == 2).any() or copied(nearest, Limits()).any() for nearest in others)


def test_short_motions_have_the_stretches_that_they_hold() -> None:
    found = near(as_set(swinging(9, 0.3), swinging(9, 0.7), swinging(9, 1.2)), TRAINING)
    assert [nearest.seconds for nearest in found] == [0.5, 1.0]
    assert [nearest.motion.tolist() for nearest in found] == [[1, 2, 2], [2]]
    assert not near(as_set(swinging(9, 0.3)), TRAINING)
    with pytest.raises(ValueError, match="no training sequence holds a stretch"):
        near(as_set(swinging(9, 3.0)), as_set(swinging(1, 0.3)))


def test_blocks_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = as_set(TAKE, swinging(20, 3.0))
    whole = near(samples, TRAINING)
    monkeypatch.setattr(copies, "BLOCK_STRETCHES", 20)
    monkeypatch.setattr(copies, "BLOCK_QUERIES", 7)
    for one, other in zip(whole, near(samples, TRAINING), strict=True):
        np.testing.assert_allclose(one.distance, other.distance, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("seed", "yaw", "height"), [(1, 0.5, 0.8), (2, -2.0, 1.1), (3, 3.0, 1.4)])
def test_bodies_places_and_headings_do_not_count(seed: int, yaw: float, height: float) -> None:
    """The distance to a take, and the movement, of a turned and scaled motion are those of the motion."""
    take = swinging(seed, 2.0)
    sine, cosine = np.sin(yaw), np.cos(yaw)
    turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    changed = (height * take @ turn.T + np.array([1.0, 2.0, 3.0])).astype(np.float32)
    one, other = (near(as_set(each), LITTLE)[1] for each in (take, changed))
    # The search looks at the nearest of candidates, which rounding may change.
    np.testing.assert_allclose(one.distance, other.distance, rtol=0.05)
    np.testing.assert_allclose(one.movement, other.movement, rtol=1e-3)


def test_distances_are_those_of_a_search_over_all_stretches() -> None:
    """Against every eighth of a frame of a take at 117 tempi, each way, by the definition."""
    samples = as_set(swinging(50, 1.1), played(swinging(2, 9.0), "1.07")[37:105])
    training = as_set(swinging(2, 3.0))
    [_, found] = near(samples, training)
    for place, distance in enumerate(found.distance):
        sequence = samples.sequences[found.motion[place]]
        least = min(by_definition(sequence, found.start_seconds[place], take) for take in training.sequences)
        # Within half a frame the search takes motion to be linear: less than a millimetre.
        assert 0.95 * least - 2e-4 < distance < 1.05 * least + 1e-3


def by_definition(sequence: np.ndarray, start_seconds: float, take: np.ndarray) -> float:
    """The least distance of a stretch of 1 s to those of one take, whose frames a cubic spline joins."""
    track = Track.of(take, FPS)
    numbers = np.concatenate((track.planar, track.upright), axis=1)
    spline = CubicSpline(np.arange(len(numbers)), numbers)
    least = np.inf
    for tempo in copies.TEMPI:
        for mirror in (False, True):
            ours = Track.of(mirrored(sequence) if mirror else sequence, FPS / tempo)
            frames = min(round(20 * start_seconds * tempo), len(ours.facing) - 19) + 2 * np.arange(10)
            for faster in np.linspace(-0.03, 0.03, 13):
                poses = 9 + (1 + faster) * (2 * np.arange(10) - 9)
                starts = np.arange(0, len(numbers) - 19, 0.125)
                theirs = spline(starts[:, None] + poses)
                for way in (frames, frames[::-1]):
                    least = min(least, least_difference(ours.planar[way], ours.upright[way], theirs))
    return float(np.sqrt(least))


def least_difference(planar: np.ndarray, upright: np.ndarray, theirs: np.ndarray) -> float:
    """Mean square difference to the nearest of many stretches, each turned as it fits best."""
    other, height = theirs[..., :21], theirs[..., 21:].real
    turned = np.abs(np.einsum("pb,spb->s", planar.conj(), other))
    lengths = (np.abs(planar) ** 2).sum() + (np.abs(other) ** 2).sum(axis=(1, 2))
    squares = lengths - 2 * turned + ((height - upright) ** 2).sum(axis=(1, 2))
    return float(squares.min() / planar.size)


@given(seed=st.integers(0, 1000))
def test_segments_are_as_near_as_the_nearest_of_their_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(6, 3)).astype(np.float32)
    queries = rng.normal(size=(4, 3)).astype(np.float32)
    step = np.append((np.diff(rows, axis=0) ** 2).sum(axis=1), 0).astype(np.float32)
    step[2] = 0  # the last of its sequence: what comes after is another's
    found = copies._to_segments(((queries[:, None] - rows) ** 2).sum(axis=-1), step)
    shares = np.linspace(0, 1, 400)[:, None]
    for row in range(6):
        end = rows[row + 1] if step[row] else rows[row]
        points = rows[row] + shares * (end - rows[row])
        least = ((queries[:, None] - points) ** 2).sum(axis=-1).min(axis=1)
        np.testing.assert_allclose(found[:, row], least, atol=1e-4)


def one_stretch_each(distances: np.ndarray) -> Nearest:
    """A motion for each distance, of one stretch of 1 s that moves by 0.1 m."""
    number = np.arange(len(distances))
    nothing = np.zeros(len(number), dtype=bool)
    zero, one = np.zeros(len(number)), np.ones(len(number))
    return Nearest(1.0, number, zero, 0.1 * one, distances, 0 * number, one, nothing, nothing)


def test_limits_accuse_one_in_a_hundred_held_out_motions() -> None:
    share = SHARES[1.0] * 0.1
    found = [one_stretch_each(share * np.linspace(0.6, 2.0, 250))]
    limits = limits_from(found, 250, "some")
    assert verdicts(found, 250, limits).accused.sum() == 2
    assert limits.num_motions == 250 and limits.factor == pytest.approx(0.6 + 2 * 1.4 / 249)


def test_limits_stay_within_half_of_the_shares_and_all() -> None:
    share = SHARES[1.0] * 0.1
    assert limits_from([one_stretch_each(np.full(60, 3.0 * share))], 60, "far").factor == 1.0
    # Held-out motion that holds the training motion itself.
    assert limits_from([one_stretch_each(np.zeros(60))], 60, "copies").factor == 0.5
    assert limits_from([], 3, "too short") == Limits()


def test_a_motion_is_let_go_up_to_its_least_factor() -> None:
    samples = as_set(
        *(low_pass(swinging(2, 9.0)[s : s + 200], float(FPS), hz) for s in (0, 99) for hz in (0.7, 1.0, 2.0))
    )
    found = near(samples, TRAINING)
    for motion, least in enumerate(least_factors(found, samples.num_sequences)):
        accused = [verdicts(found, samples.num_sequences, Limits(least + e)).accused[motion] for e in (-1e-6, 1e-6)]
        assert accused == [False, True]


def test_a_store_whose_takes_repeat_each_other_has_narrower_limits() -> None:
    """Each take twice, once with an error; by its validation motions where there are enough of them."""
    takes = [swinging(seed, 2.5) for seed in range(60, 64)]
    wobble = 0.003 * np.sin(np.arange(150) / 20)[:, None, None] * np.random.default_rng(0).normal(size=(22, 3))
    repeated = as_set(*takes, *((each + wobble).astype(np.float32) for each in takes))
    alone, twice = (limits_of(each, TrainingMotion.of(each), None) for each in (as_set(*takes), repeated))
    assert alone.factor == 1.0 and 0.5 < twice.factor < 1.0
    assert (alone.num_motions, twice.num_motions) == (4, 8)
    fresh = as_set(*(swinging(seed, 2.5) for seed in range(70, 79)))
    validated = limits_of(repeated, TrainingMotion.of(repeated), fresh)
    assert validated == Limits(1.0, 9, "validation motions")
    assert limits_of(repeated, TrainingMotion.of(repeated), as_set(takes[0])) == twice


def write_takes(path: Path, first: int, count: int) -> Store:
    with (StoreWriter.append if path.exists() else StoreWriter.create)(path) as writer:
        for seed in range(first, first + count):
            positions = swinging(seed, 2.0)
            split, grid = ("train", "val")[seed % 2], TimeGrid(FPS, len(positions))
            writer.add(Motion(positions, SMPL22, grid, split=split, sequence_id=f"take-{seed}"))
    return Store.open(path)


def test_limits_of_a_store_are_computed_once_for_each_of_its_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, computed = tmp_path / "store", []

    def limits(training: SampleSet, indexed: TrainingMotion, validation: SampleSet | None) -> Limits:
        computed.append((training.num_sequences, 0 if validation is None else validation.num_sequences))
        return Limits(0.6 + 0.01 * len(computed), training.num_sequences, "these")

    def found(store: Store, **options: bool) -> Limits:
        training = real_motion(store, "train").at(copies.FPS)
        return memorisation.limits_of_store(store, training, TrainingMotion.of(training), **options)

    monkeypatch.setattr(memorisation, "limits_of", limits)
    store = write_takes(path, 0, 6)
    first = found(store)
    assert found(store) == first
    assert found(store, with_validation=False) != first
    assert found(store) == first
    assert computed == [(3, 3), (3, 0)]
    assert found(write_takes(path, 6, 4)) != first
    assert computed[2:] == [(5, 5)]
    (path / "cache" / "copy-limits.json").write_text("{")
    with pytest.warns(MotionkitWarning, match=r"copy-limits\.json"):
        found(Store.open(path))
    assert len(computed) == 4


def test_the_block_tells_a_model_that_copies_from_one_that_does_not() -> None:
    copying = as_set(*(elsewhere(mirrored(swinging(2, 9.0)[start : start + 180])) for start in (0, 150, 300)))
    held_out = as_set(*(swinging(seed, 4.0) for seed in range(30, 34)))
    sets = {RowId("copying"): copying, RowId("too short"): as_set(swinging(0, 0.3))}
    indexed = TrainingMotion.of(TRAINING)
    block = copies_block(held_out, indexed, limits_of(TRAINING, indexed, None), sets, {RowId("copying"): "says so"})
    rows = {row.name: row for row in block.rows}
    assert set(rows) == {str(HELD_OUT), "copying"}
    assert {rows["copying"].cells[each].value for each in (ACCUSED, *COPIED.values())} == {100.0}
    assert {rows[str(HELD_OUT)].cells[each].value for each in (ACCUSED, *COPIED.values())} == {0.0}
    assert rows["copying"].cells["95 % (mm)"].value < 3 < 10 < rows[str(HELD_OUT)].cells["nearest (mm)"].value
    assert rows["copying"].note == "3 motions; says so"
    assert block.provenance["limits"] == {
        "factor": 1.0,
        "num_motions": 4,
        "found_from": "training motions, each beside all others",
    }
