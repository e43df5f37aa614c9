"""Where `motionkit demo` may write; the whole of it is run by test_front_door.py."""

from pathlib import Path

import pytest

import motionkit.demo_corpus
from eval.commands.demo import MARKER, demo
from motionkit.core.errors import UsageError


def test_another_demo_takes_the_place_of_the_first_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(UsageError, match="has other content than an earlier demo"):
        demo(tmp_path, smallest=True)
    assert (tmp_path / "thesis.tex").read_text() == "mine"


def test_a_demo_that_was_stopped_at_its_beginning_begins_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(motionkit.demo_corpus, "write_demo_corpus", stopped)
    for _ in range(2):  # there is a marker, and nothing else
        with pytest.raises(KeyboardInterrupt):
            demo(tmp_path / "demo", smallest=True)
    assert [path.name for path in (tmp_path / "demo").iterdir()] == [MARKER]


def test_a_part_of_a_demo_that_is_a_link_is_not_deleted_through(tmp_path: Path) -> None:
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo" / MARKER).touch()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    (tmp_path / "demo" / "store").symlink_to(tmp_path / "mine")
    with pytest.raises(OSError, match="symbolic link"):
        demo(tmp_path / "demo", smallest=True)
    assert (tmp_path / "mine" / "thesis.tex").exists()
