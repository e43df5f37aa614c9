"""Calibration: what passes, what fails, what is visible first; a blind feature set is found out."""

from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid import features
from eval.clip_fid.calibration import MIN_GAME_RATIO, Game, Graded, calibrate
from eval.clip_fid.clips import PoseRange, Protocol
from eval.clip_fid.features import Comparison, fit_on, fit_version_1_on
from eval.metrics.checks import Estimate
from eval.sets.games import ALIGNED
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


def takes(noise_metres: float = 0.001) -> SampleSet:
    rng = np.random.default_rng(0)
    rest = np.zeros((22, 3))
    for joint, parent in enumerate(SMPL22.parents[1:], start=1):
        rest[joint] = rest[parent] + SMPL22.offsets[joint]
    time = np.arange(200)[:, None, None] / float(FPS)
    sequences = []
    for _ in range(10):
        rate, phase = rng.uniform(0.5, 4, (22, 3)), rng.uniform(0, 6, (22, 3))
        swing = 0.05 * np.sin(2 * np.pi * rate * time + phase)
        sequences.append((rest + swing + noise_metres * rng.normal(size=swing.shape)).astype(np.float32))
    return sample_set("takes", FPS, sequences, [str(index) for index in range(10)])


class MeanHeight:
    """A feature set that is blind to everything but posture."""

    name = "blind"
    fingerprint = "blind/1"

    def describe(self, clips: np.ndarray, fps: Fraction) -> np.ndarray:
        return clips[:, :, :, 1].astype(np.float64).mean(axis=1)


def test_a_game_is_won_below_four_fifths_of_what_it_hides() -> None:
    honest = Estimate(2.0, 0.1, 3)
    lost, won = (
        Game("slow", honest, {"noise": Estimate(1.7, 0.1, 3)}),
        Game("slow", honest, {"a": Estimate(1.5, 0.1, 3)}),
    )
    assert lost.passes and lost.ratios == {"noise": 0.85}
    assert not won.passes


def test_the_descriptor_sees_jitter_and_a_blind_feature_set_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(features, "FIT_CLIPS", 512)
    real = takes()
    seen = calibrate(Comparison(real, fit_on(real), PROTOCOL), None)
    families = {family.family: family for family in seen.graded}
    assert families["jitter"].passes
    assert families["foot-sliding"].passes
    assert families["low-pass"].strengths == (10.0, 5.0, 3.0)
    assert set(seen.flat) == {"yaw", "translation", "sinc interpolation by half a frame"}
    parents = ["upsampled from 20 fps", "low-passed at 8 Hz", "low-passed at 10 Hz"]
    assert [game.parent for game in seen.games] == parents
    blind = calibrate(Comparison(real, MeanHeight(), PROTOCOL), None)
    assert not blind.passes


def test_the_first_version_is_won_by_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Motion whose tremble the capture made, low-passed: 0.3 mm of noise brings it back for version 1 alone."""
    monkeypatch.setattr(features, "FIT_CLIPS", 512)
    real = takes(noise_metres=0.0003)
    first, second = (
        calibrate(Comparison(real, fit(real), PROTOCOL, training=real), None) for fit in (fit_version_1_on, fit_on)
    )
    name = "low-passed at 8 Hz + white noise, 0.3 mm"
    ratios = [next(game for game in each.games if name in game.ratios).ratios[name] for each in (first, second)]
    assert ratios[0] < 0.3
    assert ratios[1] > ratios[0]
    assert not first.passes
    # The takes are their own training motion here, which gives them back whole.
    aligned = [ratio for game in second.games for name, ratio in game.ratios.items() if ALIGNED in name]
    assert len(aligned) == 2 and min(aligned) < MIN_GAME_RATIO and not second.passes
