"""The options of `motionkit eval`: flat for people, nested as a table's request is."""

import inspect
from dataclasses import dataclass
from fractions import Fraction
from importlib import import_module
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from eval.clip_fid.clips import SecondsRange
from eval.commands import eval_options
from eval.commands.eval_options import ClipOptions, EvaluatedOptions, EvaluatorOptions, TableOptions, in_groups
from motionkit.core.errors import UsageError
from motionkit.generate.models import ModelLoader
from tests.helpers.scripted_model import ScriptedModel


@dataclass(frozen=True)
class First:
    """Some options."""

    store: eval_options.StorePath = None
    split: eval_options.Split = "test"


@dataclass(frozen=True)
class Second:
    """Others."""

    seed: eval_options.Seed = 0


def test_options_of_groups_are_options_of_the_command() -> None:
    seen: list[tuple[First, Second]] = []

    @in_groups
    def command(first: First, second: Second) -> None:
        seen.append((first, second))

    assert list(inspect.signature(command).parameters) == ["store", "split", "seed"]
    app = typer.Typer()
    app.command()(command)
    result = CliRunner().invoke(app, ["--seed", "3", "--store", "here"])
    assert result.exit_code == 0, result.output
    command(split="all")
    assert seen == [(First(Path("here")), Second(3)), (First(split="all"), Second())]
    assert CliRunner().invoke(app, ["--seed", "-1"]).exit_code == 2


def test_options_become_what_tables_take(tmp_path: Path) -> None:
    (tmp_path / "wide").mkdir()
    evaluated = EvaluatedOptions(runs=tmp_path, run="mine", encoder=["liif=wide"], samples_fps="12.5").chosen()
    assert (evaluated.run, evaluated.encoders) == (tmp_path / "mine", (("liif", tmp_path / "wide"),))
    assert evaluated.sample_options.fps == Fraction(25, 2)
    clips = ClipOptions(fps="20, 59.94", sizes="0.4s:1.6s", clips=128)
    assert clips.framerates() == (Fraction(20), Fraction(60000, 1001))
    settings = clips.chosen(seed=7)
    assert (settings.protocol.sizes, settings.protocol.num_clips) == (SecondsRange(0.4, 1.6), 128)
    assert settings.protocol.seed == 7
    assert TableOptions(figure="5").numbers == ("figure5",) and TableOptions(calibrate=True).numbers == (None,)


@pytest.mark.parametrize(
    ("ask", "told"),
    [
        (lambda: EvaluatorOptions(glove=Path("glove")).chosen(), "--glove needs a published evaluator"),
        (lambda: EvaluatedOptions(samples_fps="x").chosen(), "--samples-fps x"),
        (lambda: EvaluatedOptions(samples=["a=here", "a=there"]).chosen(), "of this name already"),
        (lambda: ClipOptions(sizes="64:16").chosen(0), "--sizes 64:16"),
        (lambda: ClipOptions(fps="fast").framerates(), "--fps fast"),
        (lambda: TableOptions(table="1", calibrate=True).numbers, "give --table NUMBER"),
    ],
)
def test_what_means_nothing_is_refused(ask, told: str) -> None:
    with pytest.raises(UsageError, match=told):
        ask()


@pytest.mark.parametrize(
    ("samples", "taken"),
    [
        (["T2M-GPT=here", "MDM, 50 steps=there", "reality=here"], ""),
        (["T2M=here"], "T2M"),
        (["T2M, planted=here"], "T2M, planted"),
        (["real=here"], "real"),
        (["real kept at 20 fps, SLERP=here"], "real kept at 20 fps, SLERP"),
        (["ours=here", "ours, planted=there"], "ours, planted"),
        (["ours, planted=there", "ours=here"], "ours, planted"),
    ],
)
def test_samples_may_begin_like_a_system_of_the_run_but_not_be_named_like_its_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, samples: list[str], taken: str
) -> None:
    (tmp_path / "mine" / "t2m").mkdir(parents=True)
    (tmp_path / "mine" / "t2m" / "model.safetensors").touch()
    loaders = {name: ModelLoader(name, (name.lower(),), ScriptedModel) for name in ("T2M", "MDM")}
    monkeypatch.setattr(import_module("motionkit.generate.models"), "installed_models", lambda: loaders)
    options = EvaluatedOptions(runs=tmp_path, run="mine", samples=samples)
    if taken:
        with pytest.raises(UsageError, match=f"a row '{taken}' already"):
            options.chosen()
    else:
        assert len(options.chosen().samples) == len(samples)
