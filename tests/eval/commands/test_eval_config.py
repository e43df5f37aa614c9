"""`motionkit eval` fills a table's configuration; options that mean nothing are refused."""

from collections.abc import Callable
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from eval.clip_fid.score import Protocol
from eval.commands.eval import evaluate
from eval.report.results import Result
from eval.tables.table import EvalConfig, Table
from motionkit.core.errors import UsageError
from motionkit.training.run import Loader
from tests.helpers.scripted_model import ScriptedModel


@pytest.fixture
def config_of(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., EvalConfig]:
    """The configuration that a command's options make."""
    built: list[EvalConfig] = []

    def build(table: Table, config: EvalConfig) -> Result:
        built.append(config)
        return Result("t", "t/1", "t", "", ())

    def call(**options: Any) -> EvalConfig:
        evaluate(**{"table": "2", "runs": tmp_path, "run": "mine", "results": tmp_path / "results", **options})
        return built[-1]

    monkeypatch.setattr(Table, "build", build)
    return call


def test_options_become_a_configuration(config_of: Callable[..., EvalConfig], tmp_path: Path) -> None:
    (tmp_path / "wide").mkdir()
    config = config_of(encoder=["liif=wide"], samples_fps="12.5", fps="20, 59.94", sizes="8:32", clips=128, seed=7)
    assert (config.run, config.encoders) == (tmp_path / "mine", (("liif", tmp_path / "wide"),))
    assert config.sample_options.fps == Fraction(25, 2)
    assert config.fps == (Fraction(20), Fraction(60000, 1001))
    assert config.clips == Protocol(8, 32, num_clips=128, seed=7)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"glove": Path("glove")}, "--glove"),
        ({"samples": ["a=here", "a=there"]}, "of this name already"),
        ({"sizes": "64:16"}, "--sizes 64:16"),
        ({"calibrate": True}, "give --table NUMBER"),
        ({"table": None, "calibrate": True, "samples": ["a=here"]}, "leave out --samples"),
        ({"encoder": ["liif=none"]}, "there is no run"),
        ({"paper": "nobody"}, "no table 2 of 'nobody'"),
    ],
)
def test_options_that_mean_nothing_are_refused(
    config_of: Callable[..., EvalConfig], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        config_of(**options)


@pytest.mark.parametrize(
    "samples",
    [
        ["T2M=here"],
        ["real=here"],
        ["ours, planted=there", "ours=here"],
    ],
)
def test_samples_are_not_named_like_a_row_of_the_run(
    config_of: Callable[..., EvalConfig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, samples: list[str]
) -> None:
    (tmp_path / "mine" / "t2m").mkdir(parents=True)
    (tmp_path / "mine" / "t2m" / "model.safetensors").touch()
    loaders = {name: Loader(name, (name.lower(),), ScriptedModel) for name in ("T2M", "MDM")}  # type: ignore[arg-type]
    monkeypatch.setattr(import_module("motionkit.generate.models"), "installed_models", lambda: loaders)
    with pytest.raises(UsageError, match=f"a row '{samples[0].partition('=')[0]}' already"):
        config_of(samples=samples)
