"""`--where`: training and evaluation on the sequences that an SQL condition leaves, told in what they write."""

import json
from fractions import Fraction
from pathlib import Path

import pytest

from motionkit.cli import train as train_command
from motionkit.core.motion import Motion
from motionkit.core.timegrid import TimeGrid
from motionkit.features.quality import measure
from motionkit.fields.motion_field import to_motion
from motionkit.store.writer import StoreWriter
from tests.helpers.analytic import analytic_motion
from tests.helpers.tiny import SETTINGS

CLEAN = "NOT list_contains(quality_flags, 'teleport')"


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
    places = ("--store", store, "--runs", tmp_path, "--device", "cpu")
    settings = (*SETTINGS, "--set", "field.encoder.kind=fourier")
    for name, extra, windows in (("all", (), 8), ("clean", ("--where", CLEAN), 6)):
        done = motionkit("train", "--stage", "field", "--run", name, "--json", *places, *settings, *extra)
        assert done.code == 0, done.stderr
        assert json.loads(done.stdout)["stages"][0]["windows"] == windows
    config = json.loads((tmp_path / "clean" / "field" / "config.json").read_text())["config"]
    assert config["field"]["where"] == f"(split = 'train') AND ({CLEAN})"
    # The condition is part of the run: it cannot be resumed as another one.
    done = motionkit("train", "--stage", "field", "--run", "clean", "--resume", *places, *settings)
    assert done.code != 0 or "kept" in done.stderr


@pytest.mark.parametrize(("where", "told"), [("no_such_column = 1", "no_such_column"), ("fps = 17", "no sequence of")])
def test_a_condition_is_tried_before_the_first_stage_starts(motionkit, store, tmp_path, monkeypatch, where, told):
    def started(*_):
        raise AssertionError("a stage was started")

    monkeypatch.setattr(train_command, "train_stage", started)
    done = motionkit("train", "--store", store, "--runs", tmp_path, "--where", where)
    assert done.code == 2
    assert told in done.stderr
    assert not list(tmp_path.iterdir())
