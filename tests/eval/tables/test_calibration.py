"""Calibration: what passes, what fails, what is visible first; a blind feature set is found out."""

from fractions import Fraction

import numpy as np
import pytest

from eval.clip_fid import score
from eval.clip_fid.score import Comparison, Protocol, fit_on
from eval.metrics.intervals import Number
from eval.sets.damage import NUM_GAMES
from eval.sets.sets import SampleSet, sample_set
from eval.tables.calibration import MIRRORED, Scored, calibrate, first_detected, spearman, won
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions

FPS = Fraction(40)
PROTOCOL = Protocol(16, 32, num_clips=400, replications=2, detailed_replications=0)


def scored(mean: float, ci95: float = 0.1) -> Scored:
    return Scored(Number(mean, ci95), None)


def levels(*means: float) -> dict[float, Scored]:
    return {0.001 * level: scored(mean) for level, mean in enumerate(means, start=1)}


def test_damage_is_seen_from_a_strength_on_and_ranked() -> None:
    clean = scored(1.0)
    assert first_detected(clean, levels(1.1, 2.0, 5.0)) == 0.002
    assert first_detected(clean, levels(3.0, 1.05)) is None
    assert spearman(clean, levels(1.1, 2.0, 5.0)) == pytest.approx(1.0)
    assert spearman(clean, levels(3.0, 2.0, 5.0, 4.0)) < 0.95


def takes(noise_metres: float = 0.001) -> SampleSet:
    rng, rest = np.random.default_rng(0), rest_positions(SMPL22)
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


def test_a_game_is_won_where_nothing_sees_it() -> None:
    game = {"slow": scored(2.0), "hidden": scored(2.05), "worse": scored(2.2), "better": scored(1.0)}
    assert won(game) == ["hidden", "better"]


def test_the_descriptor_sees_jitter_and_a_blind_feature_set_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(score, "FIT_CLIPS", 512)
    real = takes()
    seen = calibrate(Comparison(real, fit_on(real), PROTOCOL), None)
    families = {family.name: of for family, of in seen.graded.items()}
    assert first_detected(seen.clean, families["jitter"]) and spearman(seen.clean, families["foot-sliding"]) > 0.95
    assert tuple(families["low-pass"]) == (10.0, 5.0, 3.0)
    assert set(seen.flat) == {"yaw", "translation", MIRRORED, "sinc interpolation by half a frame"}
    assert not seen.games and seen.clean.detail is None  # no detail without training motion
    blind = calibrate(Comparison(real, MeanHeight(), PROTOCOL), None)
    assert not blind.passes


def test_with_training_motion_every_game_is_played(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(score, "FIT_CLIPS", 512)
    real = takes()
    found = calibrate(Comparison(real, fit_on(real), PROTOCOL, training=real), None)
    assert len(found.games) == NUM_GAMES
    low_passed = next(of for family, of in found.graded.items() if family.name == "low-pass")
    energies = [next(iter(each.detail.energy_db.values())).value for each in low_passed.values() if each.detail]
    assert energies == sorted(energies, reverse=True) and energies[-1] < -3
