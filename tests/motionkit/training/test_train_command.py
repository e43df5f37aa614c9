import json
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from motionkit.cli import train as train_module
from motionkit.errors import UsageError
from motionkit.store import StoreWriter
from motionkit.training.stage import Stage, StageContext


@dataclass(frozen=True)
class Part:
    steps: int = 5


@dataclass(frozen=True)
class Config:
    first: Part = field(default_factory=Part)
    second: Part = field(default_factory=Part)


def _train(name: str) -> Stage[Config]:
    def train(context: StageContext, config: Config) -> None:
        folder = context.begin(name, config, store_fingerprint="abc")
        folder.finish({"steps": getattr(config, name).steps, "seed": context.seed})

    return Stage(name, 1 if name == "first" else 2, f"trains {name}", {"nano": Config}, train)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(train_module, "registered_stages", lambda: {name: _train(name) for name in ("first", "second")})
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
    assert report["stages"] == [
        {"stage": "first", "steps": 5, "seed": 3},
        {"stage": "second", "steps": 9, "seed": 3},
    ]
    assert (folder / "runs" / "nano" / "second" / "config.json").is_file()


def test_complete_stages_are_kept_by_resume(folder: Path) -> None:
    _run("--stage", "first", "--run", "mine")
    before = (folder / "runs" / "mine" / "first" / "summary.json").stat().st_mtime_ns
    _run("--run", "mine", "--resume")
    assert (folder / "runs" / "mine" / "first" / "summary.json").stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--set", "third.steps=1"],
            "no setting is called 'third.steps'; recipe 'nano' has: first.steps, second.steps",
        ),
        (["--recipe", "huge"], "has no recipe 'huge'"),
        (["--stage", "third"], "no stage is called 'third'"),
        (["--resume", "--overwrite"], "exclude each other"),
    ],
)
def test_what_makes_no_sense_is_refused_with_what_would(folder: Path, arguments: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        CliRunner().invoke(_app(), arguments, catch_exceptions=False)
