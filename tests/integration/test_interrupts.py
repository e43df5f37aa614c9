"""Ctrl-C: one line and exit code 130, whenever it comes; the server of workers leaves it to its parent."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import Outcome

from motionkit.cli import app, start
from motionkit.workers.process_engine import PRELOADED


def interrupted(*arguments: object) -> None:
    """What Ctrl-C raises."""
    raise KeyboardInterrupt


def test_an_interrupted_command_says_so(
    motionkit: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motionkit.store.Store.open", interrupted)
    outcome = motionkit("info", "--store", tmp_path)
    assert (outcome.code, outcome.stdout, outcome.stderr) == (130, "", "motionkit: stopped\n")


def test_so_does_one_that_is_being_loaded(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(app, "build_app", interrupted)
    monkeypatch.setattr("gc.freeze", lambda: None)
    with pytest.raises(SystemExit) as ended:
        start.main()
    assert ended.value.code == 130 and capsys.readouterr().err == "motionkit: stopped\n"


def test_the_server_of_workers_goes_on() -> None:
    code = f"import {PRELOADED[0]}, os, signal; os.kill(os.getpid(), signal.SIGINT); print('on')"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (ran.stdout, ran.stderr) == ("on\n", "")
