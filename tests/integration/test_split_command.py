"""`motionkit split` as a person uses it."""

import json

import pytest
import typer
from typer.testing import CliRunner

from motionkit.cli.store import split
from motionkit.store import Store


@pytest.fixture
def store(motionkit, takes, tmp_path):
    """Three takes of two people, whose names an annotation table says."""
    (takes / "takes.csv").write_text("file,subject\nalpha.bvh,anna\nbeta.bvh,ben\ngamma.bvh,anna\n")
    motionkit("ingest", takes, "--store", tmp_path / "store", "--workers", 1)
    return tmp_path / "store"


def run(*arguments):
    app = typer.Typer()
    app.command()(split)
    return CliRunner().invoke(app, list(map(str, arguments)), catch_exceptions=False)


def test_people_are_held_out(store):
    outcome = run("--shares", "train=2,test=1", "--store", store)
    assert outcome.exit_code == 0
    head, *lines, last, following = outcome.stdout.splitlines()
    assert head.split() == ["split", "share", "asked", "hours", "groups", "sequences", "wordings", "seen"]
    assert [line.split()[0] for line in lines] == ["train", "test"]
    assert following == f"next: motionkit train --store {store}"
    assert last == f"changed the split of 3 sequences of {store}, by performer"
    rows = Store.open(store).sequences
    assert sorted(rows.groupby("subject")["split"].nunique()) == [1, 1]
    assert set(rows["split"]) == {"train", "test"}
    again = run("--shares", "train=2,test=1", "--store", store, "--dry-run").stdout
    assert again.splitlines()[-1] == f"would change the split of 0 sequences of {store}, by performer"
    report = json.loads(run("--shares", "test=1", "--store", store, "--json").stdout)
    assert report["fingerprint"] == Store.open(store).fingerprint
    (only,) = report["splits"]
    assert (only["split"], only["num_groups"], only["num_sequences"], only["share"]) == ("test", 2, 3, 1.0)
