"""The drill's hostile folders: what a command does to others is seen, and ours do nothing to them."""

import math
import re
from contextlib import nullcontext
from pathlib import Path

import pytest

from benchmarks.trust import hostile
from benchmarks.trust.corruption import starts
from benchmarks.trust.process import Commands
from tests.hostile import SCENES
from tests.hostile.scene import EVIL, Scene, Spoil, links, text

CALL = "call:tests.helpers.careless:"
# A slice of `python -m benchmarks.trust hostile`: one command of some scenes of each kind.
SLICE = SCENES[::24]


@pytest.mark.parametrize(
    ("spoil", "use", "told"),
    [
        (
            links({"a.txt": "mine.txt"}),
            ("write_through", "a.txt"),
            r"outside of its folder: changed: outside/mine\.txt",
        ),
        (links({"a.txt": "new.txt"}), ("write_through", "a.txt"), "outside of its folder: new: outside/new.txt"),
        (text("a.txt", "a"), ("write_beside", "b.txt"), r"outside of its folder: new: b\.txt"),
        (links({"a.txt": "mine.txt"}), ("show", "a.txt"), "shows what lies outside of its folder"),
        (text("a.txt", EVIL), ("show", "a.txt"), r"prints .*x1b"),
        (text("a.txt", b"\xff"), ("show", "a.txt"), "exit 1: UnicodeDecodeError"),
        (text("a.txt", "a"), ("refuse_in_silence", "a.txt"), "exit 1 without a reason"),
        (text("a.txt", "a"), ("refuse", "x" * 5000), "a message of 5,0[0-9]{2} letters"),
        (text("a.txt", "a"), ("write_through", "a.txt"), ""),
        (text("a.txt", "a"), ("show", "a.txt"), ""),
        (text("a.txt", "a"), ("refuse", "a.txt"), ""),
    ],
)
def test_each_outcome_is_distinguished(
    commands: Commands, spoil: Spoil, use: tuple[str, ...], told: str, tmp_path: Path
) -> None:
    good = tmp_path / "good"
    good.mkdir()
    scene = Scene("letters", spoil, ((f"{CALL}{use[0]}", *use[1:]),))
    for _ in range(2):  # what is found once is found again
        _, fault = hostile.attempt(commands, scene, scene.commands[0], good, tmp_path / "scene")
        assert re.search(told, fault) if told else not fault


@pytest.fixture
def one_server(commands: Commands, monkeypatch: pytest.MonkeyPatch) -> None:
    """A drill's own server is the one that runs already."""
    monkeypatch.setattr(hostile, "Commands", lambda: nullcontext(commands))


def test_every_scene_has_its_turn(one_server: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(starts.MORE, "everything", ("", ((f"{CALL}write_letters", "letters"),)))
    show, spare = (f"{CALL}show", "letters"), (f"{CALL}refuse", "letters")
    scenes = [Scene(name, text("letters", "abc"), (show, spare, spare)) for name in ("first", "second")]
    report = hostile.run_scenes(scenes, 1, tmp_path, commands_each=2)
    assert [(case.name, case.tried, case.figures["refused"]) for case in report.cases] == [
        ("first", 2, 2),
        ("second", 2, 2),
    ]
    assert hostile.run_scenes(scenes, 1, tmp_path, seconds=0).tried == 0


def test_the_scenes_have_names_of_their_own() -> None:
    assert len({scene.name for scene in SCENES}) == len(SCENES)
    assert all(scene.commands for scene in SCENES)
    assert math.isfinite(hostile.DEFAULT_SECONDS)


def test_nothing_outside_of_a_hostile_folder_changes(one_server: None, tmp_path: Path) -> None:
    report = hostile.run_scenes(SLICE, 0, tmp_path, commands_each=1)
    assert report.tried == len(SLICE)
    assert report.failures == ()
