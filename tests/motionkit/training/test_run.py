"""Runs and their stages: what is kept, mixed, overwritten or refused; and `motionkit train`."""

import json
import subprocess
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from motionkit.cli import train as train_module
from motionkit.core.errors import BusyError, DamagedFileError, MotionkitWarning, UsageError
from motionkit.core.files import remove_entry
from motionkit.store import StoreWriter
from motionkit.store.commit import read_manifest
from motionkit.training.run import RunError, RunFolder, Stage, StageContext, choose_stages, commit, find_run
from tests.helpers.plugin_lists import install_only


@dataclass(frozen=True)
class Part:
    steps: int = 5


@dataclass(frozen=True)
class Config:
    width: int = 4
    first: Part = field(default_factory=Part)
    second: Part = field(default_factory=Part)


def _context(path: Path, *, resume: bool = False, overwrite: bool = False, seed: int = 0) -> StageContext:
    return StageContext(Path("store"), RunFolder(path), "nano", seed=seed, resume=resume, overwrite=overwrite)


def test_what_exists_is_neither_overwritten_nor_mixed_unasked(tmp_path: Path) -> None:
    folder = _context(tmp_path).begin("first", Config(), store_fingerprint="abc")
    folder.append_metrics({"step": 1.0})
    with pytest.raises(UsageError, match="--resume continues it"):
        _context(tmp_path).begin("first", Config(), store_fingerprint="abc")
    assert _context(tmp_path, resume=True).begin("first", Config(), store_fingerprint="abc").read_metrics()
    with pytest.raises(RunError, match="store_fingerprint 'abc' → 'abd'"):
        _context(tmp_path, resume=True).begin("first", Config(), store_fingerprint="abd")
    with pytest.raises(RunError, match="seed 0 → 1"):
        _context(tmp_path, resume=True, seed=1).begin("first", Config(), store_fingerprint="abc")
    assert not _context(tmp_path, overwrite=True).begin("first", Config(), store_fingerprint="x").read_metrics()


def test_a_changed_byte_in_a_complete_stage_is_named_with_what_to_do(tmp_path: Path) -> None:
    folder = _context(tmp_path).begin("first", Config(), store_fingerprint="abc")
    folder.append_metrics({"step": 1.0, "loss": 0.5})
    folder.finish({"loss": 0.5})
    reads = {
        folder.config_path: folder.read_config,
        folder.metrics_path: folder.read_metrics,
        folder.summary_path: folder.read_summary,
    }
    for path, read in reads.items():
        whole = path.read_text()
        read()
        path.write_text(whole.replace("5", "7", 1))
        with pytest.raises(DamagedFileError, match=rf"{path.name} is damaged .*train the stage again with --overwrite"):
            read()
        path.write_text(whole)


def test_lines_come_back_without_one_that_was_cut_off_and_none_after_a_checkpoint(tmp_path: Path) -> None:
    folder = _context(tmp_path).begin("first", Config(), store_fingerprint="abc")
    assert folder.read_metrics() == []
    for step in (1.0, 2.0, 3.0):
        folder.append_metrics({"step": step, "loss": 1 / step})
    whole = folder.metrics_path.read_bytes()
    with folder.metrics_path.open("a") as file:
        file.write('{"step": 4.0, "lo')
    assert [line["step"] for line in folder.read_metrics()] == [1, 2, 3]
    folder.keep_metrics(3)
    assert folder.metrics_path.read_bytes() == whole
    folder.keep_metrics(1)
    assert folder.read_metrics() == [{"step": 1.0, "loss": 1.0}]


@pytest.mark.parametrize("stopped_at", range(4))
def test_an_overwrite_that_was_stopped_leaves_nothing_that_another_training_takes_for_its_own(
    stopped_at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = _context(tmp_path).begin("first", Config(), store_fingerprint="abc")
    for name in ("checkpoint.safetensors", "metrics.jsonl", "model.safetensors", "summary.json"):
        (folder.path / name).touch()
    removed: list[Path] = []

    def removing(path: Path) -> None:
        if len(removed) == stopped_at:
            raise KeyboardInterrupt
        removed.append(path)
        remove_entry(path)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("motionkit.training.run.remove_entry", removing)
        _context(tmp_path, overwrite=True).begin("first", Config(width=5), store_fingerprint="abc")
    assert folder.is_complete == (stopped_at == 0)
    with pytest.raises(RunError, match="width 4 → 5"):
        _context(tmp_path, resume=True).begin("first", Config(width=5), store_fingerprint="abc")
    _context(tmp_path, overwrite=True).begin("first", Config(width=5), store_fingerprint="abc")
    assert [path.name for path in folder.path.iterdir()] == ["config.json"]


def test_stages_are_chosen_by_name_or_all_of_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    def stage(name: str) -> Stage[Config]:
        return Stage(name, "", {"nano": Config}, lambda context, config: None)

    install_only(monkeypatch, STAGES={name: stage(name) for name in ("a", "b", "extra")}, ALL=("a", "b"))
    assert [chosen.name for chosen in choose_stages("all")] == ["a", "b"]
    assert [chosen.name for chosen in choose_stages("extra")] == ["extra"]
    with pytest.raises(UsageError, match=r"'c'.*: a, b, extra, all"):
        choose_stages("c")
    with pytest.raises(UsageError, match="'a' has no recipe 'huge'"):
        stage("a").configured("huge")


def test_the_commit_is_that_of_this_code_and_of_no_checkout_around_it(tmp_path: Path) -> None:
    def git(*arguments: str) -> str:
        who = ("-c", "user.name=somebody", "-c", "user.email=somebody@example.org", "-c", "commit.gpgsign=false")
        done = subprocess.run(("git", *who, *arguments), cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    kept, installed = tmp_path / "kept.py", tmp_path / ".venv" / "installed.py"
    installed.parent.mkdir()
    for path in (kept, installed):
        path.write_text("", encoding="utf-8")
    git("init", "-q")
    git("add", "kept.py")
    git("commit", "-q", "-m", "somebody's own work")
    assert commit(kept) == git("rev-parse", "HEAD")
    assert commit(installed) is None


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
def test_a_stage_is_not_trained_twice_at_once(folder, monkeypatch, option, stage):
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


def test_a_run_is_of_the_folder_of_all_runs_or_a_folder_or_shipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("shipped/walks", "here", "runs/mine", "runs/here"):
        (tmp_path / folder).mkdir(parents=True)
    install_only(monkeypatch, RUNS={"walks": tmp_path / "shipped" / "walks"})
    assert find_run("mine") == find_run("runs/mine") == Path("runs/mine")
    assert find_run("here") == Path("runs/here")
    assert find_run("here", tmp_path / "others") == Path("here")
    assert find_run("walks") == tmp_path / "shipped" / "walks"
    assert find_run("lost") == Path("runs/lost")
    with pytest.warns(MotionkitWarning, match="using walks"):
        assert find_run(None) == tmp_path / "shipped" / "walks"
    (tmp_path / "runs" / "walks").mkdir()
    (tmp_path / "runs" / "nano").mkdir()
    assert find_run("walks") == Path("runs/walks") and find_run(None) == Path("runs/nano")
    install_only(monkeypatch, RUNS={})
    assert find_run(None, tmp_path / "others") == tmp_path / "others" / "nano"
