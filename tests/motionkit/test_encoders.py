"""Encoders found by name: interpolators, and what packages register."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motionkit.encoders import load_encoder, runs_with, trained_encoder_names
from motionkit.errors import UsageError
from motionkit.interpolation.fields import INTERPOLATORS
from motionkit.motionfield import MotionEncoder, Observation, Poses
from motionkit.skeleton import SMPL22
from motionkit.training.run import RunFolder

MODULE = '''
"""An encoder that a package brings: the named interpolator that its run folder's file asks for."""
from motionkit.encoders import load_encoder

def load(run):
    return load_encoder((run / "wanted.txt").read_text(), run)
'''


@pytest.fixture
def package(install: Callable[..., None]) -> None:
    install("borrowed_encoder", MODULE, {"motionkit.encoders": "borrowed = borrowed_encoder:load"})


def test_interpolators_need_no_run(tmp_path: Path) -> None:
    for name, interpolator in INTERPOLATORS.items():
        assert load_encoder(name, tmp_path / "no such run") is interpolator


def test_a_registered_encoder_is_loaded_from_the_run(tmp_path: Path, package: None) -> None:
    assert "borrowed" in trained_encoder_names()
    (tmp_path / "wanted.txt").write_text("linear", encoding="utf-8")
    encoder = load_encoder("borrowed", tmp_path)
    assert isinstance(encoder, MotionEncoder)
    positions = np.zeros((2, 22, 3), np.float32)
    positions[1] = 2.0
    field = encoder.encode(Observation(np.array([0.0, 1.0]), Poses(positions), SMPL22))
    np.testing.assert_allclose(field.query(np.array([0.25])).joint_positions, 0.5)


def test_an_unknown_name_is_answered_with_all_that_there_are(tmp_path: Path, package: None) -> None:
    with pytest.raises(UsageError, match=r"'sprline'.*squad.*borrowed"):
        load_encoder("sprline", tmp_path)


def test_runs_are_those_whose_stage_is_complete(tmp_path: Path) -> None:
    assert runs_with("pahires", tmp_path / "nowhere") == ()
    for name in ("half", "older", "newer"):
        RunFolder(tmp_path / name).stage("pahires").path.mkdir(parents=True)
    for name in ("newer", "older"):
        RunFolder(tmp_path / name).stage("pahires").finish({})
    for seconds, name in ((1_000, "older"), (2_000, "newer")):
        os.utime(RunFolder(tmp_path / name).stage("pahires").summary_path, (seconds, seconds))
    assert [run.name for run in runs_with("pahires", tmp_path)] == ["older", "newer"]
    assert runs_with("liif", tmp_path) == ()
