"""Every state that a store and a run can be in is told, with what to do."""

import os
import time
from pathlib import Path

import pytest
import torch

from motionkit.core.checksums import write_json
from motionkit.doctor.data import SILENT_SECONDS, run_findings, store_findings
from motionkit.doctor.finding import Finding
from motionkit.store.life.rewrite import remove
from motionkit.store.manifest import read_manifest
from motionkit.training.run import RunFolder, StageFolder
from motionkit.training.tensors import save_tensors
from tests.helpers.tiny import write_store


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return write_store(tmp_path / "store")


def states(found: list[Finding]) -> list[tuple[str, str]]:
    return [(each.state, each.remedy) for each in found]


def test_a_store_that_is_not_there_and_one_that_is_well(store: Path, tmp_path: Path) -> None:
    (none,) = store_findings(tmp_path / "none")
    assert none.state == "note" and none.remedy.startswith("motionkit ingest SOURCE --store ")
    well = list(store_findings(store))
    assert states(well) == [("good", "")] and "sequences, format version 2" in well[0].fact


def test_damage_of_each_kind_is_a_problem(store: Path) -> None:
    part = store / read_manifest(store).parts[0]
    content = part.read_bytes()
    part.write_bytes(content[:-1])
    assert [each.state for each in store_findings(store)] == ["good", "problem"]
    part.unlink()
    assert "missing" in list(store_findings(store))[1].fact
    part.write_bytes(content)
    table = store / "sequences.parquet"
    table.write_bytes(table.read_bytes()[:-1] + b"?")
    (found,) = store_findings(store)
    assert found.state == "problem" and "the tables of the store" in found.fact
    (store / "manifest.json").write_text("{")
    assert [each.state for each in store_findings(store)] == ["problem"]


def test_removed_sequences_and_leftovers_are_noted(store: Path) -> None:
    name = read_manifest(store).parts[0]
    remove(store, where="sequence_index = 0")
    (store / f"{name}.new").write_bytes(b"")
    found = list(store_findings(store))
    assert [each.state for each in found] == ["good", "note", "note"]
    assert "next command that writes" in found[1].remedy and "motionkit compact" in found[2].remedy


def stage(runs: Path, name: str, fingerprint: str) -> StageFolder:
    folder = RunFolder(runs / "first run").stage(name)
    folder.path.mkdir(parents=True)
    write_json(folder.config_path, {"config": {}, "recipe": "nano", "seed": 0, "store_fingerprint": fingerprint})
    folder.append_metrics({"step": 50.0, "loss": 1.0})
    save_tensors(folder.model_path, {"weight": torch.ones(30)}, {})
    return folder


def test_stages_are_complete_or_under_way_or_stopped(store: Path, tmp_path: Path) -> None:
    runs, fingerprint = tmp_path / "runs", read_manifest(store).fingerprint
    assert [each.remedy for each in run_findings(runs, store)] == ["motionkit train"]
    stage(runs, "codebook", fingerprint).finish({"loss": 1.0})
    begun = stage(runs, "field", fingerprint)
    now, whole = run_findings(runs, store)
    assert "in training now" in now.remedy and "field is not complete, 50 steps logged" in now.fact
    assert whole.state == "good" and whole.fact.endswith("codebook complete")
    long_ago = time.time() - 2 * SILENT_SECONDS
    for path in (begun.path, *begun.path.iterdir()):
        os.utime(path, (long_ago, long_ago))
    stopped = next(run_findings(runs, store))
    assert stopped.remedy.startswith("motionkit train --stage field --recipe nano --run 'first run' --resume")


def test_a_damaged_run_and_one_of_another_store(store: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    folder = stage(runs, "codebook", "another")
    folder.finish({"loss": 1.0})
    assert [each.state for each in run_findings(runs, store)] == ["good", "note"]
    assert [each.state for each in run_findings(runs, tmp_path / "none")] == ["good"], "nothing to compare with"
    model = folder.model_path.read_bytes()
    for length in (0, 2, 100):
        folder.model_path.write_bytes(model[:length])
        assert next(each.state for each in run_findings(runs, store)) == "problem"
    folder.model_path.write_bytes(model)
    folder.metrics_path.write_text("")
    damaged = list(run_findings(runs, store))
    assert damaged[0].state == "problem" and "metrics.jsonl is damaged" in damaged[0].fact
