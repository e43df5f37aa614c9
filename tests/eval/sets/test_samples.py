"""Sample sets, real sets at a framerate, generated sets."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import pytest

from eval.sets.motions import NoRealMotionError, RealMotion, Window, generate_fields, sample_fields, windows_of
from eval.sets.sets import Ragged, middle, sample_set
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.fields.motion_field import Poses
from motionkit.generate.models import GenerationRequest
from tests.helpers.scripted_model import ScriptedModel


def real_motion(lengths: Sequence[int], rates: Sequence[int]) -> RealMotion:
    """Joint j of every sequence swings at 1 Hz; exact at any framerate."""
    parts = [swing(np.arange(length) / rate) for length, rate in zip(lengths, rates, strict=True)]
    return RealMotion(
        name="real (test)",
        sequences=Ragged.of(parts),
        fps=tuple(Fraction(rate) for rate in rates),
        sequence_ids=tuple(f"take{i}" for i in range(len(lengths))),
        captions=tuple(f"caption {i}" for i in range(len(lengths))),
        actions=("",) * len(lengths),
    )


def swing(seconds: np.ndarray) -> np.ndarray:
    joints = np.arange(22)[None, :, None]
    return np.sin(2 * np.pi * seconds[:, None, None] + joints + np.arange(3)).astype(np.float32)


def swinging() -> ScriptedModel:
    """A model of the same swing."""
    return ScriptedModel(lambda request, chance: swing, max_duration_seconds=2.0)


def test_ragged_sequences_are_views_and_clips_are_stretches_of_their_rows() -> None:
    parts = [np.random.default_rng(n).normal(size=(n, 2, 3)).astype(np.float32) for n in (4, 1, 6)]
    together = Ragged.of(parts)
    assert (len(together), together.start_row.tolist(), together.num_frames.tolist()) == (3, [0, 4, 5], [4, 1, 6])
    assert together[2].base is together.values
    for found, part in zip(together, parts, strict=True):
        np.testing.assert_array_equal(found, part)
    np.testing.assert_array_equal(together.clips(np.array([1, 6]), 3), np.stack([parts[0][1:], parts[2][1:4]]))
    with pytest.raises(ValueError, match="11 rows for sequences of 12 frames"):
        Ragged.laid_out(together.values, [4, 1, 7])


def test_the_middle_of_a_motion() -> None:
    assert middle(np.arange(7, dtype=np.float32), 3).tolist() == [2, 3, 4]
    assert middle(np.arange(7, dtype=np.float32), 4).tolist() == [1, 2, 3, 4]
    assert middle(np.arange(2, dtype=np.float32), 4).tolist() == [0, 1]


def test_sequences_keep_their_own_frames() -> None:
    parts = [np.full((n, 22, 3), n, dtype=np.float32) for n in (3, 5, 2)]
    samples = sample_set("s", Fraction(20), parts, ["a", "b", "c"], ["x", "y", "z"])
    assert [len(part) for part in samples.sequences] == [3, 5, 2]
    np.testing.assert_array_equal(samples.sequences[1], parts[1])
    chosen = samples.select([2, 0])
    assert (chosen.sequence_ids, chosen.captions) == (("c", "a"), ("z", "x"))
    np.testing.assert_array_equal(chosen.sequences.values[:2], parts[2])
    assert samples.duration_seconds == 0.5


def test_sample_sets_refuse_nan_and_nothing() -> None:
    parts = [np.zeros((3, 22, 3), dtype=np.float32), np.full((2, 22, 3), np.nan, dtype=np.float32)]
    with pytest.raises(ValueError, match="'b' holds NaN"):
        sample_set("s", Fraction(20), parts, ["a", "b"])
    with pytest.raises(ValueError, match="no sequence"):
        sample_set("s", Fraction(20), [], [])


def test_the_real_set_at_s_fps_holds_what_was_captured_at_s_or_faster() -> None:
    real = real_motion([121, 61, 241, 241], [30, 60, 120, 120])
    assert real.at(Fraction(60)).sequence_ids == ("take1", "take2", "take3")
    assert real.at(Fraction(120)).sequence_ids == ("take2", "take3")
    assert real.at(Fraction(20)).num_sequences == 4
    assert real.at(Fraction(20)) is real.at(Fraction(20))
    with pytest.raises(NoRealMotionError, match="0 of 4 sequences were captured at 250 fps"):
        real.at(Fraction(250))


def test_the_real_set_is_the_motion_at_those_instants() -> None:
    real = real_motion([121, 241, 241], [30, 120, 120])
    at_twenty = real.at(Fraction(20))
    for sequence in at_twenty.sequences:
        inside = slice(15, len(sequence) - 15)
        expected = swing(np.arange(len(sequence)) / 20)
        np.testing.assert_allclose(sequence[inside], expected[inside], atol=2e-3)
    shifted = real.at(Fraction(20), first_frame=1).sequences[1]
    np.testing.assert_allclose(shifted[15:25], swing(np.arange(len(shifted)) / 20 + 1 / 120)[15:25], atol=2e-3)


def test_long_sequences_become_windows_of_equal_length() -> None:
    real = real_motion([31, 201], [20, 20]).at(Fraction(20))
    windows = windows_of(real, 4.0)
    assert [(window.sequence_id, window.number) for window in windows] == [
        ("take0", 0),
        ("take1", 0),
        ("take1", 1),
        ("take1", 2),
    ]
    assert [window.request.duration_seconds for window in windows] == pytest.approx([1.5, 10 / 3, 10 / 3, 10 / 3])
    assert (windows[3].request.text, windows[3].request.action) == ("caption 1", "")


@dataclass(frozen=True)
class ToldField:
    """A field that answers with the framerate it was told."""

    end_seconds: float = 4.0
    told: Fraction = Fraction(0)
    start_seconds: float = 0.0
    skeleton: Skeleton = SMPL22

    def at_fps(self, fps: Fraction) -> "ToldField":
        return replace(self, told=fps)

    def query(self, times_seconds: np.ndarray) -> Poses:
        return Poses(np.full((len(times_seconds), 22, 3), float(self.told), dtype=np.float32))


def test_fields_get_the_framerate_they_are_sampled_at() -> None:
    fields = {Window("take", 0, GenerationRequest(4.0)): ToldField()}
    for fps in (Fraction(20), Fraction(120)):
        made = sample_fields(fields, ["take"], fps, "model")
        assert made is not None
        assert np.all(made.sequences.values == float(fps))


def test_fields_are_asked_for_every_instant_of_the_framerate() -> None:
    real = real_motion([81, 201], [20, 20]).at(Fraction(20))
    model = swinging()
    fields = generate_fields(model, windows_of(real, model.max_duration_seconds), seed=0, limit=100)
    made = sample_fields(fields, ["take1"], Fraction(120), "model")
    assert made is not None
    assert (made.num_sequences, made.fps) == (5, 120)
    np.testing.assert_array_equal(made.sequences[0], swing(np.arange(241) / 120))
    assert sample_fields(fields, ["unknown"], Fraction(120), "model") is None
    assert len(generate_fields(model, windows_of(real, 2.0), seed=0, limit=3)) == 3
