"""Encoders found by name: interpolators, and what packages register."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import UsageError
from motionkit.core.skeleton import SMPL22
from motionkit.edit.encoders import choose_encoder, encoder_loader, installed_encoders, runs_with, trained_encoder_names
from motionkit.fields.interpolation import INTERPOLATORS
from motionkit.fields.motion_field import MotionEncoder, Observation, Poses
from motionkit.training.run import Loader, RunFolder
from tests.helpers.plugin_lists import install_only

MODULE = '''
"""An encoder that a package brings: the named interpolator that its run folder's file asks for."""
from motionkit.fields.interpolation import INTERPOLATORS

def load(run):
    return INTERPOLATORS[(run / "wanted.txt").read_text()]

ENCODERS = {"borrowed": load}
'''


@pytest.fixture
def package(install: Callable[..., None]) -> None:
    install("borrowed_encoder", MODULE)


def test_a_registered_encoder_is_loaded_from_the_run(tmp_path: Path, package: None) -> None:
    assert "borrowed" in trained_encoder_names()
    loader = installed_encoders()["borrowed"]
    assert (loader.title, loader.stages, loader.preferred) == ("borrowed", ("borrowed",), False)
    assert "borrowed" in installed_encoders("extrapolation") and "borrowed" not in installed_encoders("reconstruction")
    (tmp_path / "wanted.txt").write_text("linear", encoding="utf-8")
    encoder = encoder_loader("borrowed").load(tmp_path)
    assert isinstance(encoder, MotionEncoder)
    positions = np.zeros((2, 22, 3), np.float32)
    positions[1] = 2.0
    field = encoder.encode(Observation(np.array([0.0, 1.0]), Poses(positions), SMPL22))
    np.testing.assert_allclose(field.query(np.array([0.25])).joint_positions, 0.5)
    with pytest.raises(UsageError, match="'sprline'"):
        encoder_loader("sprline")


def test_clips_are_completed_by_the_preferred_encoder_that_is_trained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = Loader("Own", ("halves",), lambda run: INTERPOLATORS["linear"], preferred=True)
    install_only(monkeypatch, ENCODERS={"own": own})
    before = choose_encoder(None, None, tmp_path)
    assert not before.is_trained and "halves" in before.explanation
    folder = RunFolder(tmp_path / "run").stage("halves")
    folder.path.mkdir(parents=True)
    folder.finish({"loss": 1.0})
    chosen = choose_encoder(None, None, tmp_path)
    assert chosen.is_trained and chosen.encoder is INTERPOLATORS["linear"]
    assert choose_encoder(None, "run", tmp_path).name == "own"


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
