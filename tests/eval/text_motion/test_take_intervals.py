"""Intervals of text-to-motion's numbers: takes are resampled, rows with the same takes are paired."""

from dataclasses import replace

import numpy as np
import pytest

from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import find_text_motion_protocol
from eval.text_motion.scores import score_text_motion

PROTOCOL = replace(find_text_motion_protocol("native"), replications=3)
NUMBER = 128


def pairs(seed: int, noise: float, takes: tuple[str, ...] = ()) -> TextMotionPairs:
    texts = np.random.default_rng(0).normal(size=(NUMBER, 6))
    return TextMotionPairs(texts, texts + noise * np.random.default_rng((seed, 1)).normal(size=texts.shape), takes)


def test_every_number_has_an_interval_over_takes() -> None:
    repeated = np.random.default_rng(5).normal(size=(30, 20, 6))
    found = score_text_motion(pairs(1, 0.1), [pairs(2, 0.6), pairs(3, 0.6)], PROTOCOL, 0, repeated=repeated)
    for name in ("r_precision_top1", "r_precision_top3_motion_asks", "mm_dist", "fid", "diversity", "multimodality"):
        score = found.values[name]
        assert len(score.resampled) == 200, name
        assert score.value == np.mean(found.replications[name]), name
        assert score.ci95 > score.drawing, name
        told = [value for value in score.resampled if value is not None]
        assert np.median(told) == pytest.approx(score.value, rel=0.35), name


def test_the_interval_of_matching_distance_is_that_of_a_mean_over_takes() -> None:
    motions = pairs(2, 0.6)
    score = score_text_motion(pairs(1, 0.1), [motions], replace(PROTOCOL, replications=8), 0).values["mm_dist"]
    distances = np.linalg.norm(motions.texts - motions.motions, axis=1)
    assert score.ci95 == pytest.approx(1.96 * distances.std() / np.sqrt(NUMBER), rel=0.2)
    # Four pairs of every take are a quarter of the takes.
    grouped = replace(motions, takes=tuple(str(row // 4) for row in range(NUMBER)))
    wider = score_text_motion(pairs(1, 0.1), [grouped], PROTOCOL, 0).values["mm_dist"]
    assert score.ci95 != wider.ci95
    alone = replace(motions, takes=("one",) * NUMBER)
    assert score_text_motion(pairs(1, 0.1), [alone], PROTOCOL, 0).values["mm_dist"].resampled == ()
