"""The action protocols against plain implementations, and what they tell or refuse."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from eval.actions.scores import ACTION_PROTOCOLS, Recognition, find_action_protocol, score_actions
from eval.metrics.registry import find_metric
from tests.helpers.given_features import plain_fid

CLASSES = 4


def recognised(number: int, seed: int) -> Recognition:
    rng = np.random.default_rng(seed)
    labels = np.arange(number) % CLASSES
    features = rng.normal(size=(number, 3)) + labels[:, None]
    scores = rng.normal(size=(number, CLASSES)) + 2 * np.eye(CLASSES)[labels]
    return Recognition(features, scores, labels)


@pytest.mark.parametrize("protocol", ACTION_PROTOCOLS, ids=lambda protocol: protocol.name)
def test_each_protocol(protocol) -> None:  # type: ignore[no-untyped-def]
    counted = {"native": None, "a2m": 3000, "actor": None, "mdm": 1000}[protocol.name]
    draws: Sequence[Recognition] = [recognised(counted or 160, seed) for seed in (1, 2)]
    train, test = recognised(300, 8).features, recognised(200, 9).features
    few = replace(protocol, replications=4)
    found = score_actions({"train": train, "test": test}, draws, few, seed=0)
    for replication in range(4):
        motions = draws[replication % 2]
        features = motions.features
        hits = motions.scores.argmax(axis=1) == motions.labels
        assert found.replications["accuracy"][replication] == pytest.approx(hits.mean())
        assert found.replications["fid_train"][replication] == pytest.approx(plain_fid(train, features), rel=1e-9)
        assert found.replications["fid_test"][replication] == pytest.approx(plain_fid(test, features), rel=1e-9)
    replaced = protocol.name != "native"
    suffix = "_with_replacement" if replaced else ""
    # All pairs of the first draw, with and without a motion's distance to itself.
    features = draws[0].features
    expected = 2 * pdist(features).sum() / len(features) ** 2
    many = replace(protocol, replications=40, diversity_pairs=150)
    diversity = score_actions({}, draws[:1], many, seed=0).values["diversity" + suffix]
    assert diversity.value == pytest.approx(expected, rel=0.03)
    assert f"multimodality_by_class{suffix}" in found.values
    assert all(find_metric(name) for name in found.values)


def test_actors_spread_is_a_variance_and_no_interval() -> None:
    actor = find_action_protocol("actor")
    found = score_actions({}, [recognised(80, seed) for seed in range(20)], actor, seed=0)
    values = np.array(found.replications["accuracy"])
    assert found.values["accuracy"].drawing == pytest.approx(1.96 * values.std() / np.sqrt(20))
    assert found.values["accuracy"].ci95 > found.values["accuracy"].drawing
    assert any("not an interval" in remark for remark in found.remarks)
    assert not any("there is one set" in remark for remark in found.remarks)


def test_more_motions_than_a_protocol_counts_are_thinned_and_fewer_are_reported() -> None:
    few = replace(find_action_protocol("mdm"), replications=3, num_motions=40)
    more = score_actions({"test": recognised(90, 0).features}, [recognised(60, 1)], few, seed=0)
    assert len(set(more.replications["fid_test"])) == 3
    fewer = score_actions({}, [recognised(20, 1)], few, seed=0)
    assert any("counts 40 motions, here are 20" in remark for remark in fewer.remarks)
    assert set(fewer.values) == {
        "accuracy",
        "diversity_with_replacement",
        "multimodality_by_class_with_replacement",
    }
