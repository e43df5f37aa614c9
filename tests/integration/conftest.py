"""The command line, run in this process as a person would run it; and small captures on disk."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.cli.app import run as main
from tests.helpers.format_samples import bvh_text
from tests.helpers.outcome import Outcome
from tests.helpers.small_tables import make_tables_small


@pytest.fixture(autouse=True)
def small_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    make_tables_small(monkeypatch)


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
