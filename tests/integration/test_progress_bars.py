"""Long commands draw a bar on a terminal for each of their tasks, and leave none of them there."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.cli.console import stderr

Draw = Callable[..., str]
BAR, ERASED = "━", "\x1b[2K"


@pytest.fixture
def drawn(motionkit, monkeypatch: pytest.MonkeyPatch) -> Draw:
    """`drawn("ingest", folder, …)`: what the command draws where stderr is a terminal."""
    for name, value in {"FORCE_COLOR": "1", "TERM": "xterm", "COLUMNS": "200"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(stderr, "is_interactive", True)

    def run(*arguments: object) -> str:
        outcome = motionkit(*arguments, "--json")
        assert outcome.code == 0, outcome.stderr
        json.loads(outcome.stdout)
        assert ERASED in outcome.stderr and BAR not in outcome.stderr.rpartition(ERASED)[2], "a bar is left behind"
        return str(outcome.stderr)

    return run


def test_commands_on_stores(drawn: Draw, takes: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    for take in sorted(takes.iterdir()):
        assert "scanning" in drawn("ingest", take, "--store", store, "--workers", 1)
    assert "validate" in drawn("validate", "--store", store)
    assert "merge" in drawn("merge", tmp_path / "merged", store)
    assert "compact" in drawn("compact", "--store", store)
    assert "export" in drawn("export", tmp_path / "out", "--format", "npz", "--store", store)
    assert "read" in drawn("view", takes / "alpha.bvh", "--out", tmp_path / "page.html")
    text = drawn("complete", takes / "alpha.bvh", "--fps", 240, "--out", tmp_path / "completed")
    assert "complete" in text
