"""Models found by name, and the one that a run holds."""

from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.core.errors import UsageError
from motionkit.generate import models
from motionkit.generate.models import installed_models, load_model, model_of
from motionkit.training.run import RunFolder

MODELS = """
from motionkit.generate.models import ModelLoader
from tests.helpers.scripted_model import ScriptedModel

def load(run):
    return ScriptedModel(None, max_duration_seconds=float(run.name))

FULL = ModelLoader("Full", ("first", "second"), lambda run: ScriptedModel(None, 2.0 * float(run.name)), order=1)
"""


@pytest.fixture
def two(install: Callable[..., None], monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that a plain function loads, and one with a loader of two stages."""
    install("two_models", MODELS, {"motionkit.two": "plain = two_models:load\nfull = two_models:FULL"})
    monkeypatch.setattr(models, "GROUP", "motionkit.two")


def finish(run: Path, stage: str) -> None:
    folder = RunFolder(run).stage(stage)
    folder.path.mkdir(parents=True)
    folder.finish({"loss": 1.0})


def test_models_come_in_their_order_and_are_loaded_by_name(tmp_path: Path, two: None) -> None:
    assert list(installed_models()) == ["full", "plain"]
    assert load_model("plain", tmp_path / "3").max_duration_seconds == 3
    assert load_model("full", tmp_path / "3").max_duration_seconds == 6
    with pytest.raises(UsageError, match="no model is called 'other'; installed models: full, plain"):
        load_model("other", tmp_path)


def test_a_model_is_in_a_run_as_soon_as_one_stage_is(tmp_path: Path, two: None) -> None:
    full, plain = installed_models().values()
    finish(tmp_path, "first")
    assert full.begun_in(tmp_path) and not full.complete_in(tmp_path)
    assert not plain.begun_in(tmp_path)
    finish(tmp_path, "second")
    assert full.complete_in(tmp_path)


def test_a_run_without_a_model_names_the_command_that_trains_one(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="motionkit train --stage denoiser --run nothing trains NeRM"):
        model_of(tmp_path / "nothing")
