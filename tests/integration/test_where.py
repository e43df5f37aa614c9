"""`--where`: training and evaluation on the sequences that an SQL condition leaves, told in what they write."""

import json
from fractions import Fraction
from pathlib import Path

import pytest

from motionkit.cli import train as train_command
from motionkit.cli.train import narrowed
from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.core.timegrid import TimeGrid
from motionkit.features.quality import measure
from motionkit.fields.motion_field import to_motion
from motionkit.store.sql import conjunction
from motionkit.store.writer import StoreWriter
from motionkit.training.config import flatten
from motionkit.training.stage import registered_stages
from tests.helpers.analytic import analytic_motion

CLEAN = "NOT list_contains(quality_flags, 'teleport')"
TINY = (
    "field.schedule.steps=3",
    "field.contact_steps=10",
    "field.schedule.batch_size=4",
    "field.decoder.width=32",
    "field.decoder.num_layers=2",
    "field.encoder.kind=fourier",
    "field.windows.max_duration_seconds=3",
)


def take(index: int, split: str, glitch: bool) -> Motion:
    motion = to_motion(analytic_motion("walk", 4.0, index), Fraction(60))
    positions = motion.joint_positions.copy()
    if glitch:
        positions[100, 20] += 0.7
    return Motion(
        positions, motion.skeleton, TimeGrid(motion.fps, len(positions)), split=split, sequence_id=f"take-{index}"
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Per split four takes, the first of which has a glitch."""
    path = tmp_path_factory.mktemp("where") / "store"
    with StoreWriter.create(path) as writer:
        for index in range(8):
            motion = take(index, "train" if index < 4 else "test", glitch=index % 4 == 0)
            assert ("teleport" in measure(motion).flags) == (index % 4 == 0)
            writer.add(motion)
    return path


def test_training_leaves_out_what_the_condition_does(motionkit, store, tmp_path):
    settings = [argument for setting in TINY for argument in ("--set", setting)]
    places = ("--store", store, "--runs", tmp_path, "--device", "cpu")
    for name, extra, windows in (("all", (), 8), ("clean", ("--where", CLEAN), 6)):
        done = motionkit("train", "--stage", "field", "--run", name, "--json", *places, *settings, *extra)
        assert done.code == 0, done.stderr
        assert json.loads(done.stdout)["stages"][0]["windows"] == windows
    config = json.loads((tmp_path / "clean" / "field" / "config.json").read_text())["config"]
    assert config["field"]["where"] == f"(split = 'train') AND ({CLEAN})"
    # The condition is part of the run: it cannot be resumed as another one.
    done = motionkit("train", "--stage", "field", "--run", "clean", "--resume", *places, *settings)
    assert done.code != 0 or "kept" in done.stderr


def test_the_condition_reaches_every_stage_that_reads_sequences():
    stages = tuple(registered_stages().values())
    configs = narrowed(stages, [stage.recipe("nano") for stage in stages], CLEAN)
    found = {stage.name: flatten(config) for stage, config in zip(stages, configs, strict=True)}
    assert found["codebook"]["codebook.where"] == f"(split = 'train') AND ({CLEAN})"
    assert found["field"]["field.where"] == f"(split = 'train') AND ({CLEAN})"
    assert found["evaluator"]["training.where"] == f"(split NOT IN ('val', 'test')) AND ({CLEAN})"
    denoiser = tuple(stage for stage in stages if stage.name == "denoiser")
    with pytest.raises(UsageError, match="takes its sequences from another stage"):
        narrowed(denoiser, [stage.recipe("nano") for stage in denoiser], CLEAN)


def test_conditions_are_put_together():
    assert conjunction(None, "", "a OR b") == "a OR b"
    assert conjunction("a OR b", "c") == "(a OR b) AND (c)"
    assert conjunction(None, "") == ""


def test_evaluation_compares_with_what_the_condition_leaves(motionkit, store, tmp_path):
    small = ("--fps", "60", "--clips", "64", "--replications", "1", "--features", "kinematic", "--json")
    done = motionkit("eval", "--table", "2", "--store", store, "--results", tmp_path, "--where", CLEAN, *small)
    assert done.code == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["definition"]["where"] == CLEAN
    assert result["definition"]["real_sets"]["60 fps"]["sequences"] == 3
    assert f"split 'test' where {CLEAN}" in result["caption"]


@pytest.mark.parametrize("command", [("train", "--stage", "field", "--run", "bad"), ("eval", "--table", "2")])
def test_bad_sql_is_reported(motionkit, store, tmp_path, command):
    place = ("--runs", tmp_path) if command[0] == "train" else ("--results", tmp_path)
    done = motionkit(*command, "--store", store, *place, "--where", "no_such_column = 1")
    assert done.code == 2
    assert "no_such_column" in done.stderr


@pytest.mark.parametrize(
    ("where", "told"), [("no_such_column = 1", "no_such_column"), ("fps = 17", "holds for no sequence")]
)
def test_a_condition_is_tried_before_the_first_stage_starts(motionkit, store, tmp_path, monkeypatch, where, told):
    def started(*_):
        raise AssertionError("a stage was started")

    monkeypatch.setattr(train_command, "train_stage", started)
    done = motionkit("train", "--store", store, "--runs", tmp_path, "--where", where)
    assert done.code == 2
    assert told in done.stderr
    assert not list(tmp_path.iterdir())
