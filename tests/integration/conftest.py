"""The command line, run in this process as a person would run it; and small captures on disk."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.cli.app import main
from tests.helpers.outcome import Outcome
from tests.helpers.small_bvh import bvh_text


@pytest.fixture(autouse=True)
def few_motions_are_searched_for_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the seconds of a small Table 2 are that search, of which tests/eval knows enough."""
    monkeypatch.setattr("eval.tables.nerm.copies.MOST_MOTIONS", 3)


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
