"""What commands print and take: hostile names, progress, tables, framerates and units, curves for TensorBoard."""

import io
import json
import warnings
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import pytest

from motionkit.cli import console
from motionkit.cli.console import LineConsole, parse_rate, print_json, print_table, read_options
from motionkit.cli.train import tensorboard_events
from motionkit.core.errors import MotionkitError, UsageError, describe, printable
from motionkit.core.progress import Progress, warn
from motionkit.training.run import RunFolder, StageContext

HOSTILE = {
    "\x1b[31mred\x1b[0m": r"\x1b[31mred\x1b[0m",
    "\x9b31m": r"\x9b31m",
    "a\nmotionkit: all is well": r"a\nmotionkit: all is well",
    "a\r\tb\x08": r"a\r\tb\x08",
    "cod\u202egnp.exe": r"cod\u202egnp.exe",
    "\u2066\u2069\u200b\u2028": r"\u2066\u2069\u200b\u2028",
    "caf\udce9": r"caf\udce9",
    ":smile: [red]é 走\N{GRINNING FACE}": ":smile: [red]é 走\N{GRINNING FACE}",
}


@pytest.mark.parametrize(("text", "shown"), HOSTILE.items())
def test_texts_are_shown_and_not_obeyed(text: str, shown: str) -> None:
    assert printable(text) == shown
    file = io.StringIO()
    LineConsole(file=file, force_terminal=True).print(f"read {text}")
    assert file.getvalue() == f"read {shown}\n"


@pytest.mark.parametrize("text", HOSTILE)
def test_json_holds_the_same_text_without_a_letter_that_is_obeyed(text, capsys):
    print_json({"name": [text]})
    printed = capsys.readouterr().out
    assert all(printable(line) == line for line in printed.splitlines())
    (name,) = json.loads(printed)["name"]
    assert name == text.replace("\udce9", r"\udce9")


def test_errors_of_the_system_are_reported_with_their_file() -> None:
    assert describe(MotionkitError("a.bvh: broken")) == "a.bvh: broken"
    assert describe(OSError(28, "No space left on device", "runs/x.npy")) == "runs/x.npy: No space left on device"
    assert describe(OSError(18, "Invalid cross-device link", "a", None, "b")) == "a to b: Invalid cross-device link"


LINE_ABOVE_ERASED = "\x1b[1A\x1b[2K"


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """What a terminal is sent on stderr."""
    file = io.StringIO()
    monkeypatch.setattr(console, "stderr", LineConsole(file=file, force_terminal=True, width=100))
    return file


def test_every_task_has_a_bar_until_it_is_finished(terminal: io.StringIO) -> None:
    with console.progress() as show:
        show(Progress("outer", 1, 3))
        show(Progress("inner\x1b[2J", 7, None, "a\nb"))
        both = terminal.getvalue()
        show(Progress("inner\x1b[2J", 7, None, finished=True))
        show(Progress("outer", 2, 3))
    assert "outer" in both and "1/3" in both
    assert r"inner\x1b[2J" in both and r"a\nb" in both and "7/?" in both
    last = terminal.getvalue()[len(both) :]
    assert "2/3" in last and "inner" not in last[last.rindex("outer") :]
    assert last.endswith(LINE_ABOVE_ERASED)


def test_lines_come_every_minute(capsys: pytest.CaptureFixture[str]) -> None:
    seconds = [0.0]
    lines = console.progress_lines(clock=lambda: seconds[0])
    for now, done in ((1.0, 99), (59.0, 110), (61.0, 150), (119.0, 160), (129.0, 300)):
        seconds[0] = now
        lines(Progress("field", done, 1000, f"loss {now:g}"))
    seconds[0] = 200.0
    lines(Progress("read", 7, None, "a\nb"))
    lines(Progress("field", 300, finished=True))
    seconds[0] = 330.0
    lines(Progress("read", 9, 10))
    assert capsys.readouterr() == (
        "",
        "field: 150 of 1,000 (15%), loss 61\n"
        "field: 300 of 1,000 (30%), loss 129\n"
        "field: 300 of 1,000 (30%), loss 129; read: 7, a\\nb\n"
        "read: 9 of 10 (90%)\n",
    )


def test_warnings_are_lines_on_stderr(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(warnings, "showwarning", lambda message, *place: print(f"other: {message}"))
    console.show_warnings()
    for _ in range(2):
        warn("[bold] of a\nb")
    warnings.simplefilter("always", RuntimeWarning)
    warnings.warn("of others", RuntimeWarning, stacklevel=1)
    assert capsys.readouterr() == ("other: of others\n", 2 * "motionkit: warning: [bold] of a\\nb\n")


@pytest.mark.parametrize("name", ["real, disjoint halves of the takes (P2)", "a\x1b[2Jb"])
def test_five_framerates_stand_beside_each_other_in_80_columns(name: str) -> None:
    file, numbers = io.StringIO(), ["0.420 ± 0.306", "2.42 ± 1.52", "–", "16.8 ± 1.8", "1.72"]
    print_table([f"{rate} fps" for rate in (20, 40, 60, 100, 120)], [(name, numbers)], LineConsole(file=file, width=80))
    lines = [line.rstrip() for line in file.getvalue().splitlines()]
    assert max(map(len, lines)) <= 80 and lines.count("") == 1, "one piece"
    assert {"20", "120", "0.420", "±0.306", "–", "1.72"} <= set(" ".join(lines).split())
    assert "\x1b" not in file.getvalue()


def test_framerates_are_exact() -> None:
    assert parse_rate("30000/1001") == Fraction(30000, 1001)
    assert parse_rate(None) is None
    with pytest.raises(UsageError, match="--source-fps"):
        parse_rate("30/0", "--source-fps")


@pytest.mark.parametrize("metres", [0.0, -1.0, float("nan"), float("inf")])
def test_a_unit_is_a_positive_length(metres: float) -> None:
    with pytest.raises(UsageError, match="--unit-metres"):
        read_options(None, None, unit_metres=metres)


@dataclass(frozen=True)
class Settings:
    rate: float = 0.1


def test_what_is_logged_goes_to_tensorboard(tmp_path: Path) -> None:
    """A stage that was resumed has one curve."""
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    lines = {"first": (50, 100), "again": (75, 100)}
    for session, steps in lines.items():
        with tensorboard_events(tmp_path / "boards") as told:
            context = StageContext(tmp_path / "store", RunFolder(tmp_path / session), "nano", on_metrics=told)
            folder = context.begin("field", Settings(), store_fingerprint="")
            for step in steps:
                folder.append_metrics({"step": float(step), "loss": 1.0 / step})
    board = accumulator.EventAccumulator(str(tmp_path / "boards" / "field"))
    board.Reload()
    assert [(event.step, event.value) for event in board.Scalars("loss")] == [
        (step, pytest.approx(1.0 / step)) for step in (50, 75, 100)
    ]
