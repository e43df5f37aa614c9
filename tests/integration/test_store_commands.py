"""`motionkit remove`, `compact`, `merge` as a person uses them."""

import json

import pytest

from motionkit.store import Store


@pytest.fixture
def store(motionkit, takes, tmp_path):
    """Three takes in three small parts."""
    for take in sorted(takes.iterdir()):
        motionkit("ingest", take, "--store", tmp_path / "store", "--workers", 1)
    return tmp_path / "store"


def ids(store):
    return Store.open(store).sequences["sequence_id"].tolist()


def test_remove_and_compact(motionkit, store):
    everything = ids(store)
    outcome = motionkit("remove", everything[1], "--store", store)
    assert (outcome.code, outcome.stdout) == (0, f"removed 1 sequences from {store}, which holds 2\n")
    assert ids(store) == [everything[0], everything[2]]
    outcome = motionkit("compact", "--store", store)
    assert outcome.code == 0
    assert outcome.stdout.startswith(f"{store}: 2 parts, ")
    assert " became 1, " in outcome.stdout
    assert motionkit("compact", "--store", store).stdout == f"{store} is compact already\n"
    assert motionkit("validate", "--store", store).code == 0
    removed = json.loads(motionkit("remove", "--where", "num_frames = 6", "--store", store, "--json").stdout)
    assert removed == {
        "store": str(store),
        "removed": [everything[2]],
        "sequences_in_store": 1,
        "sequences_to_compact": 1,
    }


def test_merge(motionkit, store, tmp_path):
    outcome = motionkit("merge", tmp_path / "few", store, "--where", "num_frames < 6")
    assert (outcome.code, outcome.stdout) == (0, f"stored 2 sequences in {tmp_path / 'few'}, which holds 2\n")
    report = json.loads(motionkit("merge", tmp_path / "few", store, "--json").stdout)
    assert report == {
        "store": str(tmp_path / "few"),
        "stored": 1,
        "already_stored": 2,
        "conflicts": [],
        "sequences_in_store": 3,
    }
    assert ids(tmp_path / "few") == ids(store)
