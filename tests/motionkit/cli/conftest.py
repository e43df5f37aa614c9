"""`motionkit generate` with a model that needs no training."""

import pytest
import typer
from typer.testing import CliRunner

from motionkit.cli.generate import generate
from motionkit.generate import models
from tests.helpers.drift_model import DriftModel


@pytest.fixture
def run_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    app.command()(generate)

    def run(*arguments, model=None):
        monkeypatch.setattr(models, "model_of", lambda run: "drift")
        monkeypatch.setattr(models, "load_model", lambda name, run: model or DriftModel())
        return CliRunner().invoke(app, list(arguments), catch_exceptions=False)

    return run
