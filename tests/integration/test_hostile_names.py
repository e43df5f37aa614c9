"""Names of files that a terminal would obey, through every command that prints them."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.core.errors import printable
from tests.helpers.format_samples import bvh_text
from tests.helpers.outcome import Outcome

Run = Callable[..., Outcome]
NAMES = (
    b"a\x1b[31mred",
    b"b\nmotionkit: stored 99",
    b"c\xe2\x80\xaegnp",
    b"d\xff\x9b",
    b"e\xc2\x9b31m",
    b"f:smile:[b]",
)


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Good and broken motions of each name, in a folder of a hostile name."""
    folder = tmp_path / "s\x1b[2Jrc"
    folder.mkdir()
    for name in NAMES:
        for kind, text in (("good", bvh_text()), ("bad", "HIERARCHY\nROOT \x1b[31mx\n")):
            (folder / f"{kind}-{os.fsdecode(name)}.bvh").write_text(text)
    monkeypatch.chdir(tmp_path)
    return sorted(folder.iterdir())


def check(outcome: Outcome) -> Outcome:
    for line in (outcome.stdout + outcome.stderr).split("\n"):
        assert printable(line) == line
        assert not line.startswith("motionkit: stored")
    return outcome


def test_no_command_lets_a_name_speak_to_the_terminal(motionkit: Run, hostile: list[Path], tmp_path: Path) -> None:
    folder, store = hostile[0].parent, tmp_path / "store"
    assert check(motionkit("ingest", folder, "--store", store, "--workers", 1)).code == 0
    outcome = check(motionkit("ingest", folder, "--store", tmp_path / "other", "--workers", 1, "--json"))
    assert json.loads(outcome.stdout)["failed"] == {"hierarchy": 6, "not-unicode": 1}
    for command in (
        ["info"],
        ["info", "--quality"],
        ["validate"],
        ["split", "--by", "sequence_id"],
    ):
        assert check(motionkit(*command, "--store", store)).code == 0
        if command != ["validate"]:
            check(motionkit(*command, "--store", store, "--json"))
    for form in ([], ["--json"]):
        assert check(motionkit("query", "SELECT * FROM sequences", "--store", store, *form)).code == 0
        assert (
            check(motionkit("complete", *hostile, "--fps", 60, "--out", tmp_path / f"made{len(form)}", *form)).code == 1
        )
        assert check(motionkit("view", *hostile, "--out", tmp_path / f"{len(form)}.html", *form)).code == 1
    check(motionkit("export", tmp_path / "exported", "--store", store, "--format", "bvh"))
    assert check(motionkit("complete", tmp_path / "x\x1b.bvh", "--fps", 60)).code == 2
