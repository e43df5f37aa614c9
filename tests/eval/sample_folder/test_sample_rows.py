"""Samples in memory: one array, at any framerate."""

from fractions import Fraction

import numpy as np

from eval.sample_folder.folder import SampleFolder, SampleMotion
from eval.sets.motions import upsampled_positions
from motionkit.fields.resample import resample_positions
from tests.helpers import published_layouts as published


def test_a_folder_of_mixed_framerates_at_one() -> None:
    rates = (Fraction(20), Fraction(20), Fraction(60), Fraction(30), Fraction(25, 2), Fraction(20))
    motions = [
        SampleMotion(f"m{index}", joints, fps, caption=f"c{index}", group="g")
        for index, (joints, fps) in enumerate(zip(published.motions(), rates, strict=True))
    ]
    folder = SampleFolder.of("mine", motions)
    seen: list[int] = []
    samples = folder.at(Fraction(30), lambda: seen.append(1))
    assert len(seen) == 6
    assert samples.rows_by_group() == {"g": [0, 1, 2, 3, 4, 5]}
    assert samples.captions == tuple(f"c{index}" for index in range(6))
    for found, joints, fps in zip(samples.sequences, published.motions(), rates, strict=True):
        slower = fps < 30
        expected = (upsampled_positions if slower else resample_positions)(joints, fps, Fraction(30))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert folder.fingerprint != at_20_fps().fingerprint
    chosen = samples.select([3, 1])
    assert (chosen.groups, chosen.sequence_ids) == (("g", "g"), ("m3", "m1"))


def at_20_fps() -> SampleFolder:
    return SampleFolder.of(
        "mine", [SampleMotion(f"m{index}", joints, Fraction(20)) for index, joints in enumerate(published.motions())]
    )


def test_motions_at_the_framerate_asked_for_are_not_copied() -> None:
    folder = at_20_fps()
    samples = folder.at(Fraction(20))
    assert samples.sequences.values is folder.sequences.values
    assert samples.rows_by_group() == {f"m{index}": [index] for index in range(6)}
