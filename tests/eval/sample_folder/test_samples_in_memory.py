"""Samples in memory: at any framerate, and the real takes that they are for."""

from fractions import Fraction

import numpy as np
import pytest

from eval.sample_folder.folder import SampleFolder, SampleMotion, samples_of_takes, takes_of_samples
from eval.sets.motions import RealMotion, upsampled_positions
from eval.sets.sets import Ragged
from motionkit.fields.resample import resample_positions
from tests.helpers import published_layouts as published

FRAMES = np.zeros((40, 22, 3), dtype=np.float32)
RATES = tuple(map(Fraction, (20, 120, 120)))


def test_motions_of_several_framerates_at_one() -> None:
    rates = (Fraction(20), Fraction(20), Fraction(60), Fraction(30), Fraction(25, 2), Fraction(20))
    motions = [
        SampleMotion(f"m{index}", joints, fps, caption=f"c{index}", group="g")
        for index, (joints, fps) in enumerate(zip(published.motions(), rates, strict=True))
    ]
    folder = SampleFolder.of("mine", motions)
    samples = folder.at(Fraction(30))
    assert samples.rows_by_group() == {"g": [0, 1, 2, 3, 4, 5]}
    assert samples.captions == tuple(f"c{index}" for index in range(6))
    for found, joints, fps in zip(samples.sequences, published.motions(), rates, strict=True):
        expected = (upsampled_positions if fps < 30 else resample_positions)(joints, fps, Fraction(30))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    alone = SampleFolder.of("mine", motions[:2])
    assert alone.at(Fraction(20)).sequences.values is alone.sequences.values
    assert folder.fingerprint != alone.fingerprint


def real(captions: tuple[str, ...] = ("walk", "walk", "jump")) -> RealMotion:
    return RealMotion("real", Ragged.of([FRAMES] * 3), RATES, ("slow", "fast", "other"), captions, ("",) * 3)


def folder(*motions: tuple[str, str, str]) -> SampleFolder:
    """Motions by id, caption and group."""
    return SampleFolder.of("theirs", [SampleMotion(i, FRAMES, Fraction(120), c, group=g) for i, c, g in motions])


@pytest.mark.parametrize(
    ("motions", "takes"),
    [
        # By name, with or without folder and suffix.
        ((("a/fast.npy", "", ""), ("b/fast.npy", "", ""), ("nobody.npy", "", "")), ("fast", "fast", "")),
        # A caption's takes in turn, the fastest first.
        (
            (("0", "walk", ""), ("1", "walk", ""), ("2", "walk", ""), ("3", "jump", ""), ("4", "swim", "")),
            ("fast", "slow", "fast", "other", ""),
        ),
        # One take for each prompt.
        (tuple((str(n), "walk", f"prompt {n // 2}") for n in range(4)), ("fast", "fast", "slow", "slow")),
        ((("x", "swim", "a"), ("y", "swim", "a")), ("", "")),
    ],
)
def test_samples_have_takes_by_name_or_by_caption(
    motions: tuple[tuple[str, str, str], ...], takes: tuple[str, ...]
) -> None:
    samples = folder(*motions)
    found = takes_of_samples(samples, real())
    assert found == takes
    column = samples_of_takes(samples.at(Fraction(120)), found, real().at(Fraction(120)))
    assert column is not None
    # The take captured at 20 fps is not in the column; samples without takes stay together by prompt.
    compared = tuple(take for take in takes if take not in ("", "slow"))
    assert column.takes == (compared if any(takes) else ("a", "a"))
    assert column.generations == (
        tuple(compared[:n].count(take) for n, take in enumerate(compared)) if any(takes) else ()
    )
