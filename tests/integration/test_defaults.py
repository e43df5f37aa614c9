"""Defaults of options out of motionkit.toml, by the command line."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.outcome import Outcome
from tests.helpers.tiny import write_store

Command = Callable[..., Outcome]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MOTIONKIT_STORE", raising=False)
    return tmp_path


def test_a_commands_table_gives_its_defaults_and_the_command_line_goes_before(
    motionkit: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = write_store(folder / "other")
    (folder / "motionkit.toml").write_text('[info]\nstore = "other"\njson = true\n[train]\nrecipe = "nowhere"\n')
    assert json.loads(motionkit("info").stdout)["path"] == "other"
    assert "there is no store at none" in motionkit("info", "--store", "none").stderr
    monkeypatch.setenv("MOTIONKIT_STORE", "elsewhere")
    assert "there is no store at elsewhere" in motionkit("info").stderr
    assert "has no recipe 'nowhere'" in motionkit("train", "--store", store).stderr
    assert "has no recipe 'nor'" in motionkit("train", "--store", store, "--recipe", "nor").stderr
    assert "default: nowhere" in " ".join(motionkit("train", "--help").stdout.split())


def test_lists_numbers_and_underscores_are_as_on_the_command_line(motionkit: Command, folder: Path) -> None:
    write_store(folder / "store")
    (folder / "motionkit.toml").write_text('[train]\nset = ["field.nothing=1"]\nseed = 7\n')
    assert "field.nothing" in motionkit("train").stderr
    (folder / "motionkit.toml").write_text('[train]\nset = "field.nothing=1"\n')
    assert "field.nothing" in motionkit("train").stderr
    (folder / "motionkit.toml").write_text("[ingest]\nunit_metres = -1.0\n")
    assert "--unit-metres must be a positive number" in motionkit("ingest", folder).stderr


def test_commands_of_a_command_have_tables_of_their_own(motionkit: Command, folder: Path) -> None:
    (folder / "motionkit.toml").write_text("[study.make]\ncases = 3\n")
    assert "default: 3" in " ".join(motionkit("study", "make", "--help").stdout.split())
    for text, says in (
        ("[study]\ncases = 3", "[study.make] and [study.score]"),
        ("[study.make]\nc = 1", "option '--c'"),
    ):
        (folder / "motionkit.toml").write_text(text)
        outcome = motionkit("study", "make")
        assert outcome.code == 2 and says in outcome.stderr


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('stroe = "x"', "motionkit.toml: there is no setting and no command 'stroe' (did you mean store?)"),
        ("[trian]\nseed = 1", "there is no setting and no command 'trian' (did you mean train?)"),
        ("[info]\nqualty = true", "'motionkit info' has no option '--qualty' (did you mean quality?)"),
        ("[view]\nclips = true", "'motionkit view' has no option '--clips'"),
        ("info = 1", "info is a command, and its options stand in a table: [info]"),
        ("[info]\nquality = 1", "[info] quality is true or false, not 1"),
        ("[info]\nstore = [1]", "[info] store takes a text or a number, not [1]"),
        ("[info]\nstore = true", "[info] store takes a text or a number, not True"),
        ('[train]\nseed = "many"', "defaults of train come from motionkit.toml here: {'seed': 'many'}"),
        ("[train]\nseed = -1", "defaults of train come from motionkit.toml here: {'seed': '-1'}"),
    ],
)
def test_what_no_command_takes_is_refused_by_name(motionkit: Command, folder: Path, text: str, says: str) -> None:
    (folder / "motionkit.toml").write_text(text)
    command = next((name for name in ("view", "train") if f"[{name}]" in text), "info")
    outcome = motionkit(command)
    assert outcome.code == 2 and says in outcome.stderr
