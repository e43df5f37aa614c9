"""From a store of fast captures to generated motions with detail, by the commands."""

import json
from dataclasses import replace
from fractions import Fraction
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from motionkit.cli.app import build_app
from motionkit.fields.resample import resample_positions
from motionkit.generate.models import GenerationRequest
from motionkit.store.writer import StoreWriter
from motionkit.training.detail import load_detail
from tests.helpers.analytic import capture
from tests.helpers.scripted_model import PosesAt, ScriptedModel


def command(*arguments: object) -> str:
    result = CliRunner().invoke(build_app(), [str(each) for each in arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


def walking(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
    motion = capture(Fraction(240), "walk", 8.0)
    return lambda times: motion.joint_positions[np.round(times * 240).astype(np.int64)]


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A store whose takes tremble by 2 mm, at 120 and 60 fps, and a model that walks smoothly."""
    with StoreWriter.create(tmp_path / "store") as writer:
        for number, fps in enumerate((120, 120, 60)):
            take = capture(Fraction(fps), "walk", 5.0, noise=0.002, seed=number)
            writer.add(replace(take, sequence_id=f"take{number}", split="test" if fps == 60 else "train"))
    models = import_module("motionkit.generate.models")
    monkeypatch.setattr(models, "model_of", lambda run: "scripted")
    monkeypatch.setattr(models, "load_model", lambda name, run: ScriptedModel(walking))
    return tmp_path


def train(project: Path, *arguments: object) -> None:
    places = ("--store", project / "store", "--runs", project / "runs")
    command("train", "--stage", "detail", *places, *arguments)


def generate(project: Path, out: str, *arguments: object) -> np.ndarray:
    places = ("--runs", project / "runs", "--out", project / out)
    report = json.loads(command("generate", "a person walks", "--seconds", 4, *arguments, *places, "--json"))
    with np.load(report["motions"][0]["file"], allow_pickle=False) as arrays:
        found: np.ndarray = arrays["joint_positions"]
    return found


def test_a_store_teaches_detail_that_generated_motion_then_has(project: Path) -> None:
    train(project)
    assert load_detail(project / "runs" / "nano").power is not None
    plain, fine, again = (
        generate(project, out, *options)
        for out, options in (("a", ()), ("b", ("--detail",)), ("c", ("--detail", "--fps", "60")))
    )
    assert plain.shape == fine.shape
    step = np.linalg.norm(fine - plain, axis=-1)
    assert 0.001 < step.mean() < 0.006  # 2 mm of three coordinates, but for what lies below 10 Hz
    slower = resample_positions(fine.astype(np.float64), Fraction(120), Fraction(60))
    assert np.abs(slower - again)[30:-30].mean() < 0.05 * step.mean()
    assert json.loads((project / "b" / "generation.json").read_text())["with_detail"] is True
    other = generate(project, "d", "--detail", "--seed", 1)
    assert np.abs(other - fine).max() > 0.001
