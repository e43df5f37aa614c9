import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from motionkit.cli import train as train_module
from motionkit.core.errors import BusyError, UsageError
from motionkit.store import StoreWriter
from motionkit.store.commit import read_manifest
from motionkit.training.run import RunError, Stage, StageContext, choose_stages
from tests.helpers.plugin_lists import install_only


@dataclass(frozen=True)
class Part:
    steps: int = 5


@dataclass(frozen=True)
class Config:
    first: Part = field(default_factory=Part)
    second: Part = field(default_factory=Part)


def _train(name: str) -> Stage[Config]:
    def train(context: StageContext, config: Config) -> None:
        fingerprint = read_manifest(context.store).fingerprint
        folder = context.begin(name, config, store_fingerprint=fingerprint, builds_on=builds_on)
        folder.model_path.write_text(f"{name} {config}")
        folder.finish({"steps": getattr(config, name).steps, "seed": context.seed})

    builds_on = ("first",) if name == "second" else ()
    return Stage(name, f"trains {name}", {"nano": Config}, train, builds_on=lambda config: builds_on)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    install_only(monkeypatch, STAGES={name: _train(name) for name in ("first", "second")}, ALL=("first", "second"))
    with StoreWriter.create(tmp_path / "store"):
        pass
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _app() -> typer.Typer:
    app = typer.Typer()
    app.command()(train_module.train)
    return app


def _run(*arguments: str) -> dict[str, object]:
    result = CliRunner().invoke(_app(), [*arguments, "--json"], catch_exceptions=False)
    assert result.exit_code == 0
    return json.loads(result.stdout)  # type: ignore[no-any-return]


def test_all_stages_are_trained_and_reported(folder: Path) -> None:
    report = _run("--set", "second.steps=9", "--seed", "3")
    assert report["stages"] == [{"stage": "first", "steps": 5, "seed": 3}, {"stage": "second", "steps": 9, "seed": 3}]
    assert (folder / "runs" / "nano" / "second" / "config.json").is_file()


def test_complete_stages_are_kept_by_resume(folder: Path) -> None:
    _run("--stage", "first", "--run", "mine")
    before = (folder / "runs" / "mine" / "first" / "summary.json").stat().st_mtime_ns
    _run("--run", "mine", "--resume")
    assert (folder / "runs" / "mine" / "first" / "summary.json").stat().st_mtime_ns == before


def test_a_complete_stage_is_not_kept_for_what_it_is_not(folder: Path) -> None:
    _run("--run", "mine")
    for arguments, message in (
        (("--set", "second.steps=7"), r"second was begun from other inputs \(second.steps 5 → 7\): use the same ones"),
        (("--seed", "4"), r"first was begun from other inputs \(seed 0 → 4\)"),
    ):
        with pytest.raises(RunError, match=message):
            CliRunner().invoke(_app(), ["--run", "mine", "--resume", *arguments], catch_exceptions=False)
    # The other stage's settings are its own affair.
    _run("--run", "mine", "--stage", "first", "--set", "first.steps=6", "--overwrite")
    with pytest.raises(
        RunError, match=r"second was begun .*\(builds_on.first .* --stage second --run mine --overwrite"
    ):
        CliRunner().invoke(_app(), ["--run", "mine", "--resume", "--set", "first.steps=6"], catch_exceptions=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--set", "third.steps=1"],
            "no setting is called 'third.steps', perhaps first.steps or second.steps; 'motionkit train",
        ),
        (["--recipe", "huge"], "has no recipe 'huge'"),
        (["--stage", "third"], "no stage is called 'third'"),
        (["--resume", "--overwrite"], "exclude each other"),
    ],
)
def test_what_makes_no_sense_is_refused_with_what_would(folder: Path, arguments: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        CliRunner().invoke(_app(), arguments, catch_exceptions=False)


@pytest.mark.parametrize("stage", ["all", "evaluator"])
def test_shown_settings_make_the_recipe_of_another(stage: str) -> None:
    shown = CliRunner().invoke(_app(), ["--show", "--stage", stage], catch_exceptions=False)
    stages = choose_stages(stage)
    nano, paper = (train_module.configure(stages, recipe, []) for recipe in ("nano", "paper"))
    assert train_module.configure(stages, "paper", shown.stdout.splitlines()) == nano != paper


@pytest.mark.parametrize("option", ["--overwrite", "--resume"])
@pytest.mark.parametrize("stage", ["all", "first", "second"])
def test_a_stage_is_not_trained_twice_at_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch, option: str, stage: str
) -> None:
    """Nor one that another command trains later: what it builds on would be replaced under it."""
    whole = _train("first")
    refused: list[BusyError] = []

    def train(context: StageContext, config: Config) -> None:
        whole.train(context, config)
        if not refused:
            with pytest.raises(BusyError, match="another process is training") as caught:
                CliRunner().invoke(_app(), ["--stage", stage, option], catch_exceptions=False)
            refused.append(caught.value)

    install_only(
        monkeypatch, STAGES={"first": replace(whole, train=train), "second": _train("second")}, ALL=("first", "second")
    )
    assert [each["steps"] for each in _run("--overwrite")["stages"]] == [5, 5]  # type: ignore[attr-defined]
    assert len(refused) == 1
    _run("--stage", stage, "--overwrite")
    assert not list((folder / "runs").rglob(".*"))
