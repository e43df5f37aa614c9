"""Upsampled and smoothed sets: what they keep, and what the handicap multiplies."""

from fractions import Fraction

import numpy as np
import pytest

from eval.sets.motions import each_upsampled, upsample_as_vectors, upsampled, upsampled_positions
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.skeleton import SMPL22


def walkers(fps: int, seconds: float = 4.0, speed: float = 1.2) -> SampleSet:
    """Two rigid bodies, one walking along +Z, one along +X, whose right arm swings."""
    rest = np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    rest[:, 1] -= rest[:, 1].min()
    time = np.arange(int(seconds * fps))[:, None] / fps
    sequences = []
    for direction in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)):
        path = (speed * time * direction)[:, None]
        positions = np.repeat(rest[None], len(time), axis=0)
        if direction[0]:
            positions = positions[..., [2, 1, 0]] * [1, 1, -1]
        sequences.append((positions + path).astype(np.float32))
    return sample_set("walkers", Fraction(fps), sequences, ["z", "x"], ["forward", "sideways"])


def test_slerp_keeps_every_known_pose_and_who_is_who() -> None:
    low = walkers(20)
    high = upsampled(low, Fraction(60), "up")
    assert (high.fps, high.name, high.sequence_ids, high.captions) == (60, "up", low.sequence_ids, low.captions)
    for before, after in zip(low.sequences, high.sequences, strict=True):
        np.testing.assert_allclose(after[::3], before, atol=1e-5)


@pytest.mark.parametrize("factor", [2, 3, 6])
def test_unscaled_vectors_multiply_the_path(factor: int) -> None:
    low = walkers(20)
    high = upsample_as_vectors(low, Fraction(20 * factor), "handicapped")
    for before, after in zip(low.sequences, high.sequences, strict=True):
        length = np.linalg.norm(before[-2, 0] - before[0, 0])
        grown = np.linalg.norm(after[-1, 0] - after[0, 0])
        assert grown == pytest.approx(factor * length, rel=0.05)
        np.testing.assert_allclose(after[:, 15, 1], before[0, 15, 1], atol=1e-3)


@pytest.mark.parametrize(("fps_from", "fps_to"), [("20", "60"), ("20", "50"), ("25/2", "20"), ("20", "30000/1001")])
def test_upsampling_many_at_a_time_is_upsampling_each(fps_from: str, fps_to: str) -> None:
    rng = np.random.default_rng(0)
    take = walkers(20, 8.0).sequences[0]
    cuts = [(int(rng.integers(0, 100)), int(rng.integers(1, 60))) for _ in range(12)]
    sequences = [take[start : start + length] for start, length in cuts]
    slow, fast = Fraction(fps_from), Fraction(fps_to)
    made = list(each_upsampled(sequences, slow, fast))
    assert len(made) == len(sequences)
    for found, sequence in zip(made, sequences, strict=True):
        np.testing.assert_allclose(found, upsampled_positions(sequence, slow, fast), rtol=0, atol=1e-6)
