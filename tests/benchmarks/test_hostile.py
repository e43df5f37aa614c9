"""What a stranger may send: no command changes anything outside of its folder, shows it, or fails without a reason.

`MOTIONKIT_HOSTILE_EVERY=1 pytest tests/benchmarks/test_hostile.py` runs every scene instead of some of each kind.
"""

import hashlib
import os
import re
from pathlib import Path

import pytest

from benchmarks.trust.crash import Drill, copy, require_success
from benchmarks.trust.process import Outcome, run_command
from benchmarks.trust.scenarios import EVAL_PAHIRES, GENERATE, takes, train
from tests.hostile import SCENES
from tests.hostile.scene import EVIL, Scene, Spoil, links, text

CALL = "call:tests.helpers.careless:"
EVERY = int(os.environ.get("MOTIONKIT_HOSTILE_EVERY", "40"))
LONGEST_MESSAGE = 4000
SECRET = "somebody's own"
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
OUTSIDE = ("mine.txt", "mine.npy", "mine.npz", "mine.png", "folder/sub/mine.txt", "folder/0-smpl22-0/mine.txt")


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store, a run, results, generated motions and samples."""
    folder = tmp_path_factory.mktemp("good")
    place = Drill(folder).start_of("model")
    steps = (
        train("pahires"),
        *(takes(name, 9 * number, 3) for number, name in enumerate(("one", "three"), start=1)),
        ("ingest", "one", "--store", "other", "--workers", "1"),
        GENERATE,
        EVAL_PAHIRES,
        (f"{CALL}write_samples", "samples"),
    )
    for arguments in steps:
        require_success(run_command(place, arguments), arguments)
    return place


def attempt(scene: Scene, arguments: tuple[str, ...], good: Path, place: Path) -> str:
    """Run a command in a scene beside somebody else's folder; the fault, if any."""
    inside, outside = place / "inside", place / "outside"
    copy(good, inside)
    copy(good, outside)
    for name in OUTSIDE:
        (outside / name).parent.mkdir(parents=True, exist_ok=True)
        (outside / name).write_text(f"{SECRET}\n")
    scene.spoil(inside, outside)
    before = snapshot(place, inside)
    outcome = run_command(inside, arguments)
    changed = sorted(name for name, _ in before.items() ^ snapshot(place, inside).items())
    return f"outside of its folder: {changed[0]}" if changed else ending_fault(outcome)


def ending_fault(outcome: Outcome) -> str:
    """The fault in how a command ended or in its output."""
    output = outcome.out + outcome.err
    if outcome.code not in (0, 1, 2) or outcome.shows_traceback or outcome.is_left:
        return f"exit {outcome.code}: {outcome.last_line}"
    # For commands that validate a store or samples, the problems found are the regular output.
    if outcome.code and not outcome.out.strip() and "motionkit: " not in outcome.err:
        return f"exit {outcome.code} without a reason"
    if max(map(len, outcome.err.splitlines()), default=0) > LONGEST_MESSAGE:
        return "a long message"
    if control := CONTROL.search(output.replace("\r\n", "\n")):
        return f"prints {control[0]!r}: {output[max(0, control.start() - 60) : control.start() + 60]!r}"
    return "shows what lies outside of its folder" if SECRET in output else ""


def snapshot(folder: Path, without: Path) -> dict[str, tuple[object, ...]]:
    """Permissions, time of change and digest of each entry of a folder, without following links."""
    found = {}
    for path in folder.rglob("*"):
        if not path.is_relative_to(without):
            status, content = path.lstat(), b""
            if path.is_symlink():
                content = os.fsencode(path.readlink())
            elif path.is_file():
                content = path.read_bytes()
            found[path.relative_to(folder).as_posix()] = (
                status.st_mode,
                status.st_mtime_ns,
                hashlib.sha256(content).hexdigest(),
            )
    return found


@pytest.mark.parametrize(
    ("spoil", "use", "fault"),
    [
        (links({"a.txt": "mine.txt"}), ("write_through", "a.txt"), r"outside of its folder: outside/mine\.txt"),
        (text("a.txt", "a"), ("write_beside", "b.txt"), r"outside of its folder: b\.txt"),
        (links({"a.txt": "mine.txt"}), ("show", "a.txt"), "shows what lies outside of its folder"),
        (text("a.txt", EVIL), ("show", "a.txt"), r"prints .*x1b"),
        (text("a.txt", b"\xff"), ("show", "a.txt"), "exit 1: UnicodeDecodeError"),
        (text("a.txt", "a"), ("refuse_in_silence", "a.txt"), "exit 1 without a reason"),
        (text("a.txt", "a"), ("refuse", "x" * 5000), "a long message"),
        (text("a.txt", "a"), ("refuse", "a.txt"), ""),
    ],
)
def test_each_outcome_is_distinguished(spoil: Spoil, use: tuple[str, ...], fault: str, tmp_path: Path) -> None:
    good = tmp_path / "good"
    good.mkdir()
    found = attempt(Scene("letters", spoil, ()), (f"{CALL}{use[0]}", *use[1:]), good, tmp_path / "scene")
    assert re.search(fault, found) if fault else not found


@pytest.mark.parametrize("scene", SCENES[::EVERY], ids=lambda scene: scene.name)
def test_nothing_outside_of_a_hostile_folder_changes(scene: Scene, good: Path, tmp_path: Path) -> None:
    for arguments in scene.commands if EVERY == 1 else scene.commands[:1]:
        assert attempt(scene, arguments, good, tmp_path / "place") == "", arguments


def test_the_scenes_have_names_of_their_own() -> None:
    assert len({scene.name for scene in SCENES}) == len(SCENES)
