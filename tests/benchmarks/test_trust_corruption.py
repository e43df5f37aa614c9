"""The drill's flipped bytes: each outcome is told apart, and ours are all noticed."""

import math
import re
from contextlib import nullcontext
from pathlib import Path

import pytest

from benchmarks.trust import corruption
from benchmarks.trust.corruption import starts
from benchmarks.trust.corruption.kinds import KINDS, Kind
from benchmarks.trust.corruption.trials import Flip, Tally, Trials, choose_flip
from benchmarks.trust.process import Commands

CARELESS = "call:tests.helpers.careless:"
FLIPS_EACH = 1


@pytest.mark.parametrize(
    ("use", "told", "harmless", "detected"),
    [
        (("read_trustingly", "letters"), r"missed \(it prints something else\)", 3, 0),
        (("read_strictly", "letters"), "traceback|missed", 3, 0),
        (("read_checked", "letters", "letters"), "", 0, 8),
        (("read_checked", "letters", "something"), r"not named \(exit 1: motionkit: something is damaged", 0, 0),
        (("read_and_lose", "letters"), "detected, but different: letters", 0, 0),
    ],
)
def test_each_outcome_is_distinguished(
    commands: Commands,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    use: tuple[str, ...],
    told: str,
    harmless: int,
    detected: int,
) -> None:
    monkeypatch.setitem(starts.MORE, "letters", ("", ((f"{CARELESS}write_letters", "letters"),)))
    kind = Kind("letters", "letters", "letters", ((f"{CARELESS}{use[0]}", *use[1:]),))
    starts.make_start(commands, tmp_path, "letters")
    trials, tally = Trials(commands, tmp_path, "place"), Tally()
    for number in range(8):
        trials.flip(kind, 3, number, tally)
    assert (tally.tried, tally.harmless, tally.detected) == (8, harmless, detected)
    assert len(tally.failures) == 8 - harmless - detected
    assert all(failure.startswith("letters:3:") and re.search(told, failure) for failure in tally.failures)


def test_a_flip_changes_one_byte_and_is_made_again(tmp_path: Path) -> None:
    (tmp_path / "letters").write_bytes(bytes(1000))
    kind = Kind("letters", "", "letters", ())
    flips = [choose_flip(kind, tmp_path, 0, number) for number in range(200)]
    assert flips == [choose_flip(kind, tmp_path, 0, number) for number in range(200)]
    assert {flip.place > 900 for flip in flips} == {flip.place < 100 for flip in flips} == {True, False}
    assert all(flip.value for flip in flips)
    Flip("letters", 7, 9).apply(tmp_path)
    assert (tmp_path / "letters").read_bytes() == bytes(7) + b"\x09" + bytes(992)


def test_the_kinds_have_names_of_their_own() -> None:
    assert len({kind.name for kind in KINDS}) == len(KINDS)
    assert math.isfinite(corruption.DEFAULT_SECONDS)


# A slice of `python -m benchmarks.trust corruption`: those kinds whose starting folders are made in seconds.
SLICE = [kind for kind in KINDS if kind.name in ("manifest.json", "part")]


def test_every_flip_is_noticed_or_harmless(commands: Commands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(corruption, "Commands", lambda: nullcontext(commands))
    report = corruption.run_flips(SLICE, 0, tmp_path, flips_each=FLIPS_EACH)
    assert report.tried == FLIPS_EACH * len(SLICE)
    assert report.failures == ()
