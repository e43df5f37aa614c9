"""Calibration: what passes, what fails, what is visible first; a blind feature set is found out."""

from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid.calibration import Graded, calibrate
from eval.clip_fid.clips import PoseRange, Protocol
from eval.clip_fid.features import Comparison
from eval.clip_fid.kinematic import fit_kinematic
from eval.metrics.checks import Estimate
from eval.sets.sets import SampleSet, sample_set
from motionkit.core.skeleton import SMPL22

FPS = Fraction(40)
PROTOCOL = Protocol(sizes=PoseRange(16, 32), num_clips=400, replications=2, detailed_replications=0)


def graded(*means: float, ci95: float = 0.1) -> Graded:
    scores = tuple(Estimate(mean, ci95, 3) for mean in means)
    return Graded("jitter", "m", tuple(0.001 * level for level in range(1, len(means))), scores)


def test_a_rising_family_passes_and_shows_when_it_is_seen() -> None:
    rising = graded(1.0, 1.1, 2.0, 5.0)
    assert rising.passes
    assert rising.spearman == pytest.approx(1.0)
    assert rising.first_visible == 0.002


def test_a_family_that_falls_back_fails() -> None:
    assert not graded(1.0, 3.0, 2.0, 5.0, 4.0).passes
    assert graded(1.0, 3.0, 1.05).first_visible is None
    assert graded(1.0, 0.9, 1.0).first_visible is None


def takes() -> SampleSet:
    rng = np.random.default_rng(0)
    rest = np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    time = np.arange(200)[:, None, None] / float(FPS)
    sequences = []
    for _ in range(10):
        rate, phase = rng.uniform(0.5, 4, (22, 3)), rng.uniform(0, 6, (22, 3))
        swing = 0.05 * np.sin(2 * np.pi * rate * time + phase)
        sequences.append((rest + swing + 0.001 * rng.normal(size=swing.shape)).astype(np.float32))
    return sample_set("takes", FPS, sequences, [str(index) for index in range(10)])


class MeanHeight:
    """A feature set that is blind to everything but posture."""

    name = "blind"
    fingerprint = "blind/1"

    def describe(self, clips: np.ndarray, fps: Fraction) -> np.ndarray:
        return clips[:, :, :, 1].astype(np.float64).mean(axis=1)


def test_the_descriptor_sees_jitter_and_a_blind_feature_set_is_found_out() -> None:
    real = takes()
    clips = np.stack([sequence[start : start + 24] for sequence in real.sequences for start in range(0, 170, 10)])
    seen = calibrate(Comparison(real, fit_kinematic([clips], FPS), PROTOCOL), None)
    families = {family.family: family for family in seen.graded}
    assert families["jitter"].passes
    assert families["foot-sliding"].passes
    assert families["low-pass"].strengths == (10.0, 5.0, 3.0)
    assert set(seen.flat) == {"yaw", "translation", "sinc interpolation by half a frame"}
    blind = calibrate(Comparison(real, MeanHeight(), PROTOCOL), None)
    assert not blind.passes
