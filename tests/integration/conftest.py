"""The command line, run in this process as a person would run it; and small captures on disk."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from small_bvh import bvh_text

from motionkit.cli.app import main


@dataclass(frozen=True)
class Outcome:
    """Exit code and what was printed."""

    code: int
    stdout: str
    stderr: str

    @property
    def error_lines(self) -> list[str]:
        """What was told about faults; a warning is none (of the small BVH: that it lacks a right side)."""
        return [line for line in self.stderr.splitlines() if not line.startswith("warning: ")]


@pytest.fixture
def motionkit(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """`motionkit("ingest", folder, …)`: the installed command with these arguments."""

    def run(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["motionkit", *map(str, arguments)])
        capsys.readouterr()
        code = 0
        try:
            main()
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return run


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """A folder of three good BVH files."""
    folder = tmp_path / "takes"
    folder.mkdir()
    for name, frames in (("alpha", 4), ("beta", 5), ("gamma", 6)):
        (folder / f"{name}.bvh").write_text(bvh_text(frames))
    return folder
