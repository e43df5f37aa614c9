"""Sample sets; real motion at a framerate, generated and upsampled motion; remarks on sets that mislead."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import pytest

from eval.metrics.distributions import fid
from eval.sets.motions import (
    NoRealMotionError,
    RealMotion,
    Window,
    generate_fields,
    sample_fields,
    upsampled,
    windows_of,
)
from eval.sets.sets import Ragged, SampleSet, sample_set, size_remark
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.fields.motion_field import Poses
from motionkit.generate.models import GenerationRequest
from tests.helpers.scripted_model import ScriptedModel


def swing(seconds: np.ndarray) -> np.ndarray:
    """Every joint swings at 1 Hz."""
    joints = np.arange(22)[None, :, None]
    return np.sin(2 * np.pi * seconds[:, None, None] + joints + np.arange(3)).astype(np.float32)


def real_motion(lengths: Sequence[int], rates: Sequence[int]) -> RealMotion:
    return RealMotion(
        name="real (test)",
        sequences=Ragged.of([swing(np.arange(length) / rate) for length, rate in zip(lengths, rates, strict=True)]),
        fps=tuple(Fraction(rate) for rate in rates),
        sequence_ids=tuple(f"take{i}" for i in range(len(lengths))),
        captions=tuple(f"caption {i}" for i in range(len(lengths))),
        actions=("",) * len(lengths),
    )


def test_a_set_selects_sequences_with_what_is_known_of_them() -> None:
    parts = [np.full((n, 22, 3), n, dtype=np.float32) for n in (3, 5, 2)]
    samples = sample_set("s", Fraction(20), parts, ["a", "b", "c"], ["x", "y", "z"])
    chosen = samples.select([2, 0])
    assert (chosen.sequence_ids, chosen.captions, chosen.actions) == (("c", "a"), ("z", "x"), ())
    np.testing.assert_array_equal(chosen.sequences.values[:2], parts[2])
    assert samples.duration_seconds == 0.5
    parts[1][0] = np.nan
    for refused, ids in ((parts, ["a", "b", "c"]), ([], []), (parts[2:], ["a", "b"])):
        with pytest.raises(ValueError):
            sample_set("s", Fraction(20), refused, ids)


def test_the_real_set_at_a_framerate_holds_what_was_captured_so_fast() -> None:
    real = real_motion([121, 61, 241, 241], [30, 60, 120, 120])
    assert real.at(Fraction(60)).sequence_ids == ("take1", "take2", "take3")
    assert real.at(Fraction(20)) is real.at(Fraction(20)) and real.at(Fraction(20)).num_sequences == 4
    with pytest.raises(NoRealMotionError, match="0 of 4 sequences were captured at 250 fps"):
        real.at(Fraction(250))
    for sequence in real.at(Fraction(20)).sequences:
        expected = swing(np.arange(len(sequence)) / 20)
        np.testing.assert_allclose(sequence[15:-15], expected[15:-15], atol=2e-3)
    shifted = real.at(Fraction(20), first_frame=1).sequences[2]
    np.testing.assert_allclose(shifted[15:25], swing(np.arange(len(shifted)) / 20 + 1 / 120)[15:25], atol=2e-3)


def test_long_sequences_become_windows_of_equal_length() -> None:
    windows = windows_of(real_motion([31, 201], [20, 20]).at(Fraction(20)), 4.0)
    assert [(each.sequence_id, each.number) for each in windows] == [
        ("take0", 0), ("take1", 0), ("take1", 1), ("take1", 2)
    ]  # fmt: skip
    assert [each.request.duration_seconds for each in windows] == pytest.approx([1.5, 10 / 3, 10 / 3, 10 / 3])
    assert (windows[3].request.text, windows[3].request.action) == ("caption 1", "")


@dataclass(frozen=True)
class FramerateField:
    """A field whose every coordinate is the framerate that it is sampled at."""

    end_seconds: float = 4.0
    fps: Fraction = Fraction(0)
    start_seconds: float = 0.0
    skeleton: Skeleton = SMPL22

    def at_fps(self, fps: Fraction) -> "FramerateField":
        return replace(self, fps=fps)

    def query(self, times_seconds: np.ndarray) -> Poses:
        return Poses(np.full((len(times_seconds), 22, 3), float(self.fps), dtype=np.float32))


def test_fields_are_sampled_at_every_instant_of_a_framerate_that_they_know() -> None:
    real = real_motion([81, 201], [20, 20]).at(Fraction(20))
    model = ScriptedModel(lambda request, chance: swing, max_duration_seconds=2.0)
    fields = generate_fields(model, windows_of(real, 2.0), seed=0, limit=100)
    samples = sample_fields(fields, ["take1"], Fraction(120), "model")
    assert samples is not None and (samples.num_sequences, samples.fps) == (5, 120)
    np.testing.assert_array_equal(samples.sequences[0], swing(np.arange(241) / 120))
    assert sample_fields(fields, ["unknown"], Fraction(120), "model") is None
    assert len(generate_fields(model, windows_of(real, 2.0), seed=0, limit=3)) == 3
    aware = sample_fields({Window("take", 0, GenerationRequest(4.0)): FramerateField()}, ["take"], Fraction(20), "m")
    assert aware is not None and (aware.sequences.values == 20.0).all()


def walkers(fps: int, seconds: float = 4.0, speed: float = 1.2) -> SampleSet:
    """Two rigid bodies, one walking along +Z, one along +X."""
    rest = rest_positions(SMPL22)
    rest = rest - [0.0, rest[:, 1].min(), 0.0]
    path = speed * np.arange(int(seconds * fps))[:, None, None] / fps
    sequences = [rest + path * [0.0, 0.0, 1.0], rest[:, [2, 1, 0]] * [1, 1, -1] + path * [1.0, 0.0, 0.0]]
    return sample_set("walkers", Fraction(fps), [each.astype(np.float32) for each in sequences], ["z", "x"])


def test_slerp_keeps_every_known_pose() -> None:
    low = walkers(20)
    high = upsampled(low, Fraction(60), "up")
    assert (high.fps, high.name, high.sequence_ids) == (60, "up", low.sequence_ids)
    for before, after in zip(low.sequences, high.sequences, strict=True):
        np.testing.assert_allclose(after[::3], before, atol=1e-5)


RNG = np.random.default_rng(0)
REAL = RNG.normal(size=(300, 12)) * np.linspace(0.1, 30, 12)


def test_fewer_motions_are_reported_with_what_as_many_real_ones_score() -> None:
    few = RNG.normal(size=(50, 12)) * np.linspace(0.1, 30, 12)
    remark = size_remark(REAL, few, seed=3)
    assert remark.startswith("as many random real motions (50) have an FID of ")
    mean = float(remark.split("FID of ")[1].split(" from")[0])
    drawn = [fid(REAL, REAL[np.random.default_rng(i).choice(300, 50, replace=False)]) for i in range(200)]
    assert abs(mean - np.mean(drawn)) < 3 * np.std(drawn) / np.sqrt(10)
    assert size_remark(REAL[:50], few, seed=3) == size_remark(REAL, REAL + 0.5, seed=0) == ""


def test_sequences_are_cut_from_a_random_frame() -> None:
    whole = [np.arange(length * 66, dtype=np.float32).reshape(length, 22, 3) for length in (90, 30, 50)]
    samples = sample_set("takes", Fraction(20), whole, ("a", "b", "c"))
    starts = set()
    for seed in range(20):
        cut = samples.cut(np.array([40, 40, 50]), np.random.default_rng(seed))
        assert cut.sequences.num_frames.tolist() == [40, 30, 50] and cut.sequence_ids == samples.sequence_ids
        for cropped, own in zip(cut.sequences, whole, strict=True):
            first = int(cropped[0, 0, 0]) // 66
            np.testing.assert_array_equal(cropped, own[first : first + len(cropped)])
        starts.add(int(cut.sequences[0][0, 0, 0]) // 66)
    assert len(starts) > 5 and max(starts) <= 50
