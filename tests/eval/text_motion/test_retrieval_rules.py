"""The rules of TMR and Kimodo: who is ranked among whom, and which texts count as one."""

import numpy as np
import pytest

from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import KIMODO, TMR
from eval.text_motion.retrieval import no_distance, score_retrieval, share_of_same_texts

RNG = np.random.default_rng(0)
TEXTS = RNG.normal(size=(120, 40))
TEXTS[60:] = TEXTS[:60]  # every text stands twice
SENTENCES = TEXTS.astype(np.float32)
MOTIONS = RNG.normal(size=(120, 40))
REAL = TextMotionPairs(TEXTS, TEXTS + 0.01 * MOTIONS)
ALL, SAME, FEW, POOLS = TMR.retrieval


def value(rule, pairs: TextMotionPairs, name: str, **more) -> float:
    return score_retrieval(REAL, [pairs], rule, SENTENCES, 0, **more)[name].value


def test_real_pairs_are_found_and_random_ones_are_not() -> None:
    own, random = REAL, TextMotionPairs(TEXTS, MOTIONS)
    assert value(ALL, own, "recall_at_2") == 1.0 and 0.3 < value(ALL, own, "recall_at_1") < 0.7
    for direction in ("", "_motion_asks"):
        assert value(SAME, own, f"recall_at_1{direction}") == 1.0 == value(SAME, own, f"median_rank{direction}")
        assert value(ALL, random, f"recall_at_10{direction}") < 0.2
        assert value(ALL, random, f"median_rank{direction}") > 40
    assert value(POOLS, own, "recall_at_1") > value(ALL, own, "recall_at_1")  # fewer of the doubles meet
    assert value(FEW, own, "recall_at_3") == 1.0


def test_chance_is_what_the_rule_leaves_to_it() -> None:
    assert value(ALL, REAL, "recall_at_1", distance=no_distance) == pytest.approx(1 / 120)
    assert value(SAME, REAL, "recall_at_1", distance=no_distance) == pytest.approx(2 / 120)
    assert value(FEW, REAL, "recall_at_10", distance=no_distance) == pytest.approx(10 / 100)
    assert value(POOLS, REAL, "recall_at_5", distance=no_distance) == pytest.approx(5 / 32)
    assert share_of_same_texts(SAME, REAL, SENTENCES) == pytest.approx(1 / 119)
    assert share_of_same_texts(ALL, REAL, SENTENCES) == 0


def test_an_evaluator_that_cannot_tell_texts_apart_wins_kimodos_rule_and_not_tmrs() -> None:
    blind = TextMotionPairs(np.ones((120, 40)) + 1e-3 * TEXTS, MOTIONS)
    (rule,) = KIMODO.retrieval
    assert value(rule, blind, "recall_at_1") == 1.0
    assert share_of_same_texts(rule, blind, SENTENCES) == 1.0  # which the table says
    assert value(SAME, blind, "recall_at_1") < 0.1
    assert value(rule, blind, "recall_at_1_real_asked") == 1.0


def test_motions_ask_for_the_real_ones_and_draws_are_averaged() -> None:
    (rule,) = KIMODO.retrieval
    near, far = TextMotionPairs(TEXTS, REAL.motions + 1e-4 * MOTIONS), TextMotionPairs(TEXTS, MOTIONS)
    values = [score_retrieval(REAL, [each], rule, SENTENCES, 0)["recall_at_1_real_asked"].value for each in (near, far)]
    assert values[0] == 1.0 and values[1] < 0.1
    both = score_retrieval(REAL, [near, far], rule, SENTENCES, 0)["recall_at_1_real_asked"]
    assert both.value == pytest.approx(np.mean(values))


def test_too_few_pairs_for_a_pool_are_refused() -> None:
    few = TextMotionPairs(TEXTS[:20], MOTIONS[:20])
    with pytest.raises(ValueError, match="20 pairs do not fill a pool of 32"):
        score_retrieval(few, [few], POOLS, SENTENCES[:20], 0)
