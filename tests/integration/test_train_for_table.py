"""`motionkit train --for table:2 && motionkit eval --table 2` from nothing but a store, at a size of seconds."""

import json
from pathlib import Path

import pytest

from benchmarks.trust.scenarios import SETTINGS
from motionkit.generate.models import installed_models
from motionkit.training.run import RunFolder
from tests.helpers.tiny_peers import write_captioned_store

# Of every system's settings those that it has.
TINY = (
    *("conditions.kind=action", "network.transformer.width=32", "network.transformer.inner=32"),
    *("motions.max_frames=130", "motions.min_seconds=1", "motions.mirrored=false"),
    *("network.diffusion.num_steps=4", "network.diffusion.sampling_steps=4"),
    *("schedule.steps=3", "schedule.batch_size=4", *SETTINGS["codebook"].split()),
)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_captioned_store(tmp_path_factory.mktemp("systems") / "store", held_out=4)


def test_a_table_has_a_row_for_every_installed_system(motionkit, store, tmp_path):
    places = ("--store", store, "--runs", tmp_path / "runs", "--run", "all")
    options = ("--fps", "20", "--clips", "64", "--replications", "1", "--evaluator", "kinematic")
    table = ("eval", "--table", "2", *places, *options, "--results", tmp_path / "results")
    settings = [word for setting in TINY for word in ("--set", setting)]
    command = ("train", "--for", "table:2", *places, "--device", "cpu", *settings)

    before = motionkit(*table)
    assert before.code == 0
    assert "motionkit train --for table:2 --run all trains the missing ones" in before.stderr

    done = motionkit(*command)
    assert done.code == 0, done.stderr
    assert "next: motionkit eval --table 2" in done.stdout
    models = installed_models().values()
    stages = [name for model in models for name in model.stages]
    run = RunFolder(tmp_path / "runs" / "all")
    assert all(run.stage(name).is_complete for name in stages)
    again = motionkit(*command)
    assert again.code == 0 and again.stderr.count("complete already, kept") >= len(stages)

    after = motionkit(*table)
    assert after.code == 0 and "trains the missing ones" not in after.stderr
    result = json.loads((tmp_path / "results" / "nerm-table2.json").read_text())
    rows = {row["name"] for row in result["blocks"][0]["rows"]}
    for model in models:
        title = model.load(run.path).name
        assert {title, f"{title}, planted"} <= rows, result["missing"]
