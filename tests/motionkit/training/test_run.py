import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from motionkit.core.errors import DamagedFileError, UsageError
from motionkit.core.files import remove_entry
from motionkit.training.run import RunError, RunFolder, Stage, StageContext, choose_stages, commit
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
        file.writelines(f"{line}\n" for line in ("[" * 100_000, '{"step": "1"}', '{"step": 2, "loss": []}', "7"))
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
        stage("a").recipe("huge")


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
