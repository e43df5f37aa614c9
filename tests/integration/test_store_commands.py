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


def test_dry_runs_say_what_would_go_and_change_nothing(motionkit, store, tmp_path):
    whole = tmp_path / "whole"
    motionkit("merge", whole, store)
    first, before = ids(whole)[0], Store.open(whole).fingerprint
    said = motionkit("remove", first, "--store", whole, "--dry-run")
    assert said.code == 0 and f"  {first}\nwould remove 1 sequences from {whole}" in said.stdout
    plan = json.loads(motionkit("remove", first, "--store", whole, "--dry-run", "--json").stdout)
    assert plan["would_remove"] == [first]
    assert motionkit("remove", "nobody", "--store", whole, "--dry-run").code == 1
    assert motionkit("remove", "--where", "fps = 1", "--store", whole, "--dry-run").code == 2
    assert Store.open(whole).fingerprint == before


def test_what_was_removed_comes_back_with_its_sources(motionkit, store, takes):
    everything = ids(store)
    motionkit("remove", everything[1], "--store", store)
    motionkit("ingest", takes / "beta.bvh", "--store", store, "--workers", 1)
    assert sorted(ids(store)) == sorted(everything)


def test_info_tells_what_removed_sequences_still_take(motionkit, store, tmp_path):
    motionkit("merge", tmp_path / "one-part", store)
    assert "motionkit compact" not in motionkit("info", "--store", tmp_path / "one-part").stdout
    motionkit("remove", "--where", "num_frames = 5", "--store", tmp_path / "one-part")
    lines = motionkit("info", "--store", tmp_path / "one-part").stdout.splitlines()
    assert any(line.startswith("of it the frames of 1 removed sequences") for line in lines)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        ((), 2, "name the sequences to remove"),
        (("nobody",), 1, "holds no sequence 'nobody'"),
        (("--where", "fps = 1"), 2, "no sequence of"),
        (("--where", "nonsense = 1"), 2, "duckdb"),
    ],
)
def test_removals_that_make_no_sense(motionkit, store, arguments, code, says):
    before = Store.open(store).fingerprint
    outcome = motionkit("remove", *arguments, "--store", store)
    assert outcome.code == code
    assert says in outcome.stderr
    assert Store.open(store).fingerprint == before


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


def test_merge_of_conflicts(motionkit, store, takes, tmp_path):
    other = takes / "alpha.bvh"
    other.write_text(other.read_text() + "\n")
    motionkit("ingest", other, "--store", tmp_path / "other", "--workers", 1)
    name = ids(tmp_path / "other")[0]
    outcome = motionkit("merge", store, tmp_path / "other")
    assert outcome.code == 1
    assert f"1 ids stand for different files: {name!r}" in outcome.stderr
    outcome = motionkit("merge", store, tmp_path / "other", "--on-conflict", "skip")
    assert outcome.code == 0
    assert f"left out: {name!r} is there from another file" in outcome.stderr
    assert outcome.stdout.splitlines()[-1] == "left out: 1 whose ids are there from other files"


def test_what_is_asked_of_no_store(motionkit, takes, tmp_path):
    outcome = motionkit("info", "--store", takes / "alpha.bvh")
    assert outcome.code == 1 and "is a file, and a store is a folder" in outcome.stderr
    assert motionkit("ingest", takes, "--store", tmp_path / "store").code == 0
    outcome = motionkit("query", "SELECT * FROM takes", "--store", tmp_path / "store")
    assert outcome.code == 2
    assert outcome.stderr.strip() == (
        "motionkit: there is no table takes; the tables of a store are sequences, motions and skeletons"
    )


def test_wide_rows_are_blocks(motionkit, takes, tmp_path):
    store = tmp_path / "store"
    motionkit("ingest", takes, "--store", store)
    lines = motionkit("query", "SELECT * FROM sequences ORDER BY 1", "--store", store).stdout.splitlines()
    assert [line for line in lines if line.startswith("row ")] == ["row 1", "row 2", "row 3"]
    assert [line.split() for line in lines if line.startswith("  sequence_id ")] == [
        ["sequence_id", f"takes/{name}"] for name in ("alpha", "beta", "gamma")
    ]
    narrow = motionkit("query", "SELECT sequence_id, num_frames FROM sequences ORDER BY 1", "--store", store).stdout
    assert len(narrow.splitlines()) == 7 and "takes/alpha" in narrow


def test_lengths_that_differ_by_rounding_are_one_skeleton(motionkit, takes, tmp_path):
    """LaFAN1 writes one body's lengths as 43.500000 and 43.499996; a body that is a millimetre taller is another."""
    text = (takes / "alpha.bvh").read_text()
    (takes / "alpha.bvh").write_text(text.replace("OFFSET 0 40 0", "OFFSET 0 40.000004 0"))
    (takes / "delta.bvh").write_text(text.replace("OFFSET 0 40 0", "OFFSET 0 40.1 0"))
    motionkit("ingest", takes, "--store", tmp_path / "store")
    store = Store.open(tmp_path / "store")
    kinds = dict(zip(store.sequences["sequence_id"], store.sequences["skeleton"], strict=True))
    assert kinds["takes/alpha"] == kinds["takes/beta"] == kinds["takes/gamma"] != kinds["takes/delta"]
    assert len(store.skeletons) == 2 and motionkit("validate", "--store", store.path).code == 0
