"""Every protocol against a plain implementation with its settings written out again; what it tells or refuses."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.metrics.metric import find_metric
from eval.metrics.number import Scores
from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import TEXT_MOTION_PROTOCOLS, MultiModalityRule, find_text_motion_protocol
from eval.text_motion.scores import score_text_motion
from motionkit.core.errors import UsageError

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


def make_pairs(number: int, seed: int, noise: float = 1.0) -> TextMotionPairs:
    rng = np.random.default_rng(seed)
    texts = rng.normal(size=(number, FEATURES))
    return TextMotionPairs(texts, texts + noise * rng.normal(size=texts.shape))


def plain_fid(x: np.ndarray, y: np.ndarray) -> float:
    a, b = np.cov(x, rowvar=False), np.cov(y, rowvar=False)
    root = np.sqrt(np.maximum(np.linalg.eigvals(a @ b).real, 0)).sum()
    return float(((x.mean(0) - y.mean(0)) ** 2).sum() + np.trace(a) + np.trace(b) - 2 * root)


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
def test_each_protocol_is_what_its_publication_computes(protocol) -> None:  # type: ignore[no-untyped-def]
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


def score(protocol: str = "native", number: int = 96, **options: object) -> Scores:
    few = replace(find_text_motion_protocol(protocol), replications=2)
    real = make_pairs(number, 0)
    return score_text_motion(real, [make_pairs(number, 1)], few, 0, **options)  # type: ignore[arg-type]


@given(seed=st.integers(0, 50), number=st.integers(64, 100))
@settings(max_examples=10)
def test_real_motion_scored_against_itself_has_no_distance_where_it_is_paired(seed: int, number: int) -> None:
    real = make_pairs(number, seed)
    few = replace(find_text_motion_protocol("native"), replications=1)
    found = score_text_motion(real, [real], few, seed)
    assert found.values["fid"].value == pytest.approx(0, abs=1e-9)
    again = score_text_motion(real, [real], replace(few, reference="redraw", remainder="every metric"), seed)
    dropped = number % 32
    assert (again.values["fid"].value > 1e-6) == (dropped > 0)


def test_a_different_number_of_motions_is_refused_or_reported() -> None:
    real, fewer = make_pairs(96, 0), make_pairs(64, 1)
    with pytest.raises(ValueError, match="64 generated and 96 real motions: give those that belong together"):
        score_text_motion(real, [fewer], find_text_motion_protocol("mld"), 0)
    redrawn = replace(find_text_motion_protocol("mdm"), replications=1)
    told = score_text_motion(real, [fewer], redrawn, 0)
    assert any("counts 1,024 generated motions, here are 64" in remark for remark in told.remarks)
    assert told.sizes == {"real": 96, "generated": 64, "draws": 1}


def test_what_the_data_cannot_give_is_reported() -> None:
    remarks = score(repeated=np.zeros((3, 12, FEATURES))).remarks
    assert any("10 pairs need 20 motions of each text, there are 12" in remark for remark in remarks)
    assert any("Diversity pairs 96 motions, not 300" in remark for remark in remarks)
    assert any("there is one set of motions" in remark for remark in remarks)
    some = score(repeated=np.random.default_rng(0).normal(size=(3, 20, FEATURES)))
    assert any("asks 30 motions of 100 texts for MultiModality; here are 20 motions of 3" in r for r in some.remarks)
    assert "multimodality" in some.values and "multimodality" not in score().values
    wide = TextMotionPairs(*np.random.default_rng(0).normal(size=(2, 40, 64)))
    few = replace(find_text_motion_protocol("native"), replications=1)
    assert any("N = 40 for 64 features" in remark for remark in score_text_motion(wide, [wide], few, 0).remarks)


def test_refusals() -> None:
    native = find_text_motion_protocol("native")
    with pytest.raises(ValueError, match="no set of motions"):
        score_text_motion(make_pairs(64, 0), [], native, 0)
    with pytest.raises(ValueError, match="20 motions: a text chooses among 32"):
        score_text_motion(make_pairs(20, 0), [make_pairs(20, 1)], native, 0)
    broken = make_pairs(64, 1)
    broken.motions[3] = np.nan
    with pytest.raises(ValueError, match="finite"):
        score_text_motion(make_pairs(64, 0), [broken], native, 0)
    narrow = TextMotionPairs(np.zeros((64, 3)), np.zeros((64, 3)))
    with pytest.raises(ValueError, match="real motions have 5 numbers, of generated ones 3"):
        score_text_motion(make_pairs(64, 0), [narrow], native, 0)
    with pytest.raises(UsageError, match="no text-to-motion protocol 'mmd': native, nerm, t2m"):
        find_text_motion_protocol("mmd")
    with pytest.raises(ValueError, match="do not fill a pool"):
        replace(native, num_motions=31)
    assert MultiModalityRule(pairs="distinct").metric == "multimodality"
