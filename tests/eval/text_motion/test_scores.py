"""Every protocol against a plain implementation with its settings written out again; intervals; retrieval's rules."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from eval.metrics.registry import find_metric
from eval.text_motion.protocol import (
    TEXT_MOTION_PROTOCOLS,
    RetrievalRule,
    TextMotionProtocol,
    find_text_motion_protocol,
)
from eval.text_motion.scores import (
    TextMotionPairs,
    score_retrieval,
    score_text_motion,
    share_of_same_texts,
)
from tests.helpers.given_features import plain_fid

SEED, FEATURES = 11, 5


@dataclass(frozen=True)
class Plain:
    """A protocol as its publication's code reads, independent of ours."""

    counted: int | None
    drops_last_batch: bool
    paired: bool | None
    texts: int | None
    distinct: bool
    mm_replications: int


PLAIN = {
    "native": Plain(None, False, True, 100, True, 20),
    "nerm": Plain(1000, False, None, 100, True, 20),
    "t2m": Plain(None, True, False, 100, False, 20),
    "mdm": Plain(1024, True, False, 128, False, 5),
    "mld": Plain(None, False, True, 100, False, 20),
    "t2m-gpt": Plain(None, True, True, None, False, 20),
    "momask": Plain(None, True, True, 96, False, 20),
    "mardm": Plain(None, True, True, 96, False, 20),
    "tmr": Plain(None, False, True, 100, True, 20),
    "kimodo": Plain(None, False, True, 100, True, 20),
}


def pairs_of(texts: np.ndarray, motions: np.ndarray) -> TextMotionPairs:
    return TextMotionPairs(texts, motions, tuple(map(str, range(len(texts)))))


def make_pairs(number: int, seed: int, noise: float = 1.0) -> TextMotionPairs:
    rng = np.random.default_rng(seed)
    texts = rng.normal(size=(number, FEATURES))
    return pairs_of(texts, texts + noise * rng.normal(size=texts.shape))


def plain_precision(queries: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    hits = np.zeros(3)
    batches = [range(start, start + 32) for start in range(0, len(queries) - 31, 32)]
    for batch in batches:
        for query in batch:
            nearest = sorted(batch, key=lambda other: float(np.linalg.norm(queries[query] - candidates[other])))
            hits += [query in nearest[:rank] for rank in (1, 2, 3)]
    return hits / (32 * len(batches))


def plain_multimodality(repeated: np.ndarray, plain: Plain, rng: np.random.Generator) -> float:
    if plain.texts is not None and len(repeated) > plain.texts:
        repeated = repeated[rng.choice(len(repeated), size=plain.texts, replace=False)]
    if plain.distinct:
        order = rng.permuted(np.tile(np.arange(30), (len(repeated), 1)), axis=1)
        pairs = [(text, order[text, k], order[text, 10 + k]) for text in range(len(repeated)) for k in range(10)]
    else:
        first, second = rng.permutation(30)[:10], rng.permutation(30)[:10]
        pairs = [(text, first[k], second[k]) for text in range(len(repeated)) for k in range(10)]
    return float(np.mean([np.linalg.norm(repeated[t, a] - repeated[t, b]) for t, a, b in pairs]))


def plain_scores(
    plain: Plain, real: TextMotionPairs, generated: TextMotionPairs, repeated: np.ndarray, replication: int
) -> dict[str, float]:
    order = np.random.default_rng((SEED, replication, 0)).permutation(len(generated.motions))
    if plain.counted is not None:
        order = order[: plain.counted]
    batches = order[: len(order) // 32 * 32]
    seen = batches if plain.drops_last_batch else order
    if plain.paired is None:
        reference = real.motions
    elif plain.paired:
        reference = real.motions[seen]
    else:
        again = np.random.default_rng((SEED, replication, 1)).permutation(len(real.motions))
        reference = real.motions[again[: len(again) // 32 * 32]]
    motions = generated.motions[seen]
    text_asks = plain_precision(generated.texts[batches], generated.motions[batches])
    motion_asks = plain_precision(generated.motions[batches], generated.texts[batches])
    rng = np.random.default_rng((SEED, replication, 2))
    size = min(300, len(motions))
    first, second = rng.choice(len(motions), size, replace=False), rng.choice(len(motions), size, replace=False)
    found = {f"r_precision_top{rank + 1}": text_asks[rank] for rank in range(3)}
    found |= {f"r_precision_top{rank + 1}_motion_asks": motion_asks[rank] for rank in range(3)}
    found["mm_dist"] = float(np.linalg.norm(generated.texts[batches] - generated.motions[batches], axis=1).mean())
    found["fid"] = plain_fid(reference, motions)
    pairs = zip(first, second, strict=True)
    found["diversity"] = float(np.mean([np.linalg.norm(motions[a] - motions[b]) for a, b in pairs]))
    if replication < plain.mm_replications:
        name = "multimodality" if plain.distinct else "multimodality_shared_pairs"
        found[name] = plain_multimodality(repeated, plain, np.random.default_rng((SEED, replication, 3)))
    return found


@pytest.mark.parametrize("protocol", TEXT_MOTION_PROTOCOLS, ids=lambda protocol: protocol.name)
def test_each_protocol_is_what_its_publication_computes(protocol: TextMotionProtocol) -> None:
    plain = PLAIN[protocol.name]
    number = 1100 if plain.counted else 150
    real, draws = make_pairs(number, 0), [make_pairs(number, 1, 1.5), make_pairs(number, 2, 2.0)]
    repeated = np.random.default_rng(3).normal(size=(140, 30, FEATURES))
    assert protocol.replications == 20
    few = replace(protocol, replications=3)
    found = score_text_motion(real, draws, few, SEED, repeated=repeated)
    expected = [plain_scores(plain, real, draws[r % 2], repeated, r) for r in range(3)]
    for name in expected[0]:
        values = [each[name] for each in expected if name in each]
        assert found.replications[name] == pytest.approx(values, rel=1e-9), name
    assert set(found.values) - set(expected[0]) == set(protocol.details)
    assert found.sizes["generated"] == (plain.counted if plain.counted else 128 if plain.drops_last_batch else 150)
    for name in found.values:
        assert find_metric(name).name == name


def test_multimodality_stops_after_its_own_replications() -> None:
    protocol = replace(find_text_motion_protocol("mdm"), num_motions=None, replications=7)
    repeated = np.random.default_rng(0).normal(size=(4, 30, FEATURES))
    found = score_text_motion(make_pairs(64, 0), [make_pairs(64, 1)], protocol, 0, repeated=repeated)
    assert len(found.replications["multimodality_shared_pairs"]) == 5
    assert len(found.replications["fid"]) == 7


NATIVE = replace(find_text_motion_protocol("native"), replications=3)


@pytest.mark.parametrize(
    ("protocol", "generated", "generations", "remark"),
    [
        ("native", 96, 12, "needs 20 motions of each text, there are 12"),
        ("native", 96, 20, "here are 20 motions of 3 texts"),
        ("native", 96, 30, "Diversity pairs 96 motions"),
        ("native", 96, 30, "there is one set of motions"),
        ("native", 4, 30, "N = 4 for 5 features"),
        ("mdm", 64, 30, "counts 1,024 generated motions, here are 64"),
    ],
)
def test_what_the_data_cannot_give_is_reported(protocol: str, generated: int, generations: int, remark: str) -> None:
    few = replace(find_text_motion_protocol(protocol), replications=2, pool=min(32, generated))
    repeated = np.random.default_rng(0).normal(size=(3, generations, FEATURES))
    found = score_text_motion(make_pairs(96, 0), [make_pairs(generated, 1)], few, 0, repeated=repeated)
    assert any(remark in each for each in found.remarks)
    assert (few.multimodality.metric in found.values) == (generations > 12)
    assert (found.sizes["real"], found.sizes["generated"]) == (96, generated)


def test_real_motion_against_itself_has_no_fid_but_of_dropped_remainders() -> None:
    real = make_pairs(70, 0)
    assert score_text_motion(real, [real], NATIVE, 0).values["fid"].value == pytest.approx(0, abs=1e-9)
    redraw = replace(NATIVE, reference="redraw", remainder="every metric")
    assert score_text_motion(real, [real], redraw, 0).values["fid"].value > 1e-6


@pytest.mark.parametrize(
    ("generated", "protocol", "message"),
    [
        (make_pairs(20, 1), "native", "at least 32 pairs"),
        (pairs_of(np.zeros((64, FEATURES)), np.full((64, FEATURES), np.nan)), "native", "finite"),
        (make_pairs(96, 1), "mld", "96 generated and 64 real"),
    ],
)
def test_pairs_that_do_not_fit_are_refused(generated: TextMotionPairs, protocol: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        score_text_motion(make_pairs(64, 0), [generated], find_text_motion_protocol(protocol), 0)


NUMBER = 128


def of_takes(seed: int, noise: float) -> TextMotionPairs:
    texts = np.random.default_rng(0).normal(size=(NUMBER, 6))
    return pairs_of(texts, texts + noise * np.random.default_rng((seed, 1)).normal(size=texts.shape))


def test_every_number_has_an_interval_over_takes() -> None:
    repeated = np.random.default_rng(5).normal(size=(30, 20, 6))
    found = score_text_motion(of_takes(1, 0.1), [of_takes(2, 0.6), of_takes(3, 0.6)], NATIVE, 0, repeated=repeated)
    for name in ("r_precision_top1", "r_precision_top3_motion_asks", "mm_dist", "fid", "diversity", "multimodality"):
        score = found.values[name]
        assert len(score.resampled) == 200, name
        assert score.value == np.mean(found.replications[name]), name
        assert score.ci95 > score.drawing, name
        told = [value for value in score.resampled if value is not None]
        assert np.median(told) == pytest.approx(score.value, rel=0.35), name


def test_the_interval_of_matching_distance_is_that_of_a_mean_over_takes() -> None:
    motions = of_takes(2, 0.6)
    score = score_text_motion(of_takes(1, 0.1), [motions], replace(NATIVE, replications=8), 0).values["mm_dist"]
    distances = np.linalg.norm(motions.texts - motions.motions, axis=1)
    assert score.ci95 == pytest.approx(1.96 * distances.std() / np.sqrt(NUMBER), rel=0.2)
    # Four pairs of every take are a quarter of the takes.
    grouped = replace(motions, takes=tuple(str(row // 4) for row in range(NUMBER)))
    wider = score_text_motion(of_takes(1, 0.1), [grouped], NATIVE, 0).values["mm_dist"]
    assert score.ci95 != wider.ci95
    alone = replace(motions, takes=("one",) * NUMBER)
    assert score_text_motion(of_takes(1, 0.1), [alone], NATIVE, 0).values["mm_dist"].resampled == ()


RNG = np.random.default_rng(0)
TEXTS = RNG.normal(size=(120, 40))
TEXTS[60:] = TEXTS[:60]  # every text stands twice
SENTENCES = TEXTS.astype(np.float32)
MOTIONS = RNG.normal(size=(120, 40))
REAL = pairs_of(TEXTS, TEXTS + 0.01 * MOTIONS)
ALL, SAME, FEW, POOLS = find_text_motion_protocol("tmr").retrieval
(KIMODO,) = find_text_motion_protocol("kimodo").retrieval


def value(rule: RetrievalRule, pairs: TextMotionPairs, name: str, **more: Any) -> float:
    return score_retrieval(REAL, [pairs], rule, SENTENCES, 0, **more)[name].value


def test_real_pairs_are_found_and_random_ones_are_not() -> None:
    own, random = REAL, pairs_of(TEXTS, MOTIONS)
    assert value(ALL, own, "recall_at_2") == 1.0 and 0.3 < value(ALL, own, "recall_at_1") < 0.7
    for direction in ("", "_motion_asks"):
        assert value(SAME, own, f"recall_at_1{direction}") == 1.0 == value(SAME, own, f"median_rank{direction}")
        assert value(ALL, random, f"recall_at_10{direction}") < 0.2
        assert value(ALL, random, f"median_rank{direction}") > 40
    assert value(POOLS, own, "recall_at_1") > value(ALL, own, "recall_at_1")  # fewer of the doubles meet
    assert value(FEW, own, "recall_at_3") == 1.0


def no_distance(queries: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    return np.zeros((len(queries), len(candidates)))


def test_chance_is_what_the_rule_leaves_to_it() -> None:
    assert value(ALL, REAL, "recall_at_1", distance=no_distance) == pytest.approx(1 / 120)
    assert value(SAME, REAL, "recall_at_1", distance=no_distance) == pytest.approx(2 / 120)
    assert value(FEW, REAL, "recall_at_10", distance=no_distance) == pytest.approx(10 / 100)
    assert value(POOLS, REAL, "recall_at_5", distance=no_distance) == pytest.approx(5 / 32)
    assert share_of_same_texts(SAME, REAL, SENTENCES) == pytest.approx(1 / 119)
    assert share_of_same_texts(ALL, REAL, SENTENCES) == 0


def test_an_evaluator_that_cannot_tell_texts_apart_wins_kimodos_rule_and_not_tmrs() -> None:
    blind = pairs_of(np.ones((120, 40)) + 1e-3 * TEXTS, MOTIONS)
    assert value(KIMODO, blind, "recall_at_1") == 1.0
    assert share_of_same_texts(KIMODO, blind, SENTENCES) == 1.0  # which the table says
    assert value(SAME, blind, "recall_at_1") < 0.1
    assert value(KIMODO, blind, "recall_at_1_real_asked") == 1.0


def test_draws_are_averaged() -> None:
    near, far = pairs_of(TEXTS, REAL.motions + 1e-4 * MOTIONS), pairs_of(TEXTS, MOTIONS)
    values = [value(KIMODO, each, "recall_at_1_real_asked") for each in (near, far)]
    both = score_retrieval(REAL, [near, far], KIMODO, SENTENCES, 0)["recall_at_1_real_asked"]
    assert values[0] == 1.0 and values[1] < 0.1 and both.value == pytest.approx(np.mean(values))
