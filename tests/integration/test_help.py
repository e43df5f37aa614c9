"""What the command line says of itself: help, versions, completion, bars; and the example of every command, run."""

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from importlib.metadata import version
from pathlib import Path

import pytest
import typer
from rich.text import Text

import motionkit as mk
from motionkit.cli.app import build_app
from motionkit.cli.console import stderr
from tests.helpers.analytic import capture
from tests.helpers.outcome import Outcome

# In the order in which a person would come to them.
RUN = (
    *("ingest", "info", "split", "validate", "query", "view", "complete", "plant", "merge", "export", "samples"),
    *("study", "ablate", "push", "remove", "compact"),
)
# These train first: test_howtos runs such commands out of README, test_front_door the demo. What is
# pulled has to be pushed: test_hub. test_convert converts, test_generate packs, test_mmcp serves.
ELSEWHERE = ("train", "generate", "eval", "report", "demo", "pull", "convert", "pack", "serve")
COMMANDS = typer.main.get_command(build_app()).commands  # type: ignore[attr-defined]


def examples() -> dict[str, list[str]]:
    """The words behind `motionkit` of each command's example."""
    lines = {name: re.findall(r"^Example: motionkit (.*)$", each.help, re.MULTILINE) for name, each in COMMANDS.items()}
    return {name: shlex.split(each[0]) if len(each) == 1 else [] for name, each in lines.items()}


def test_every_command_has_one_example_of_its_own() -> None:
    assert examples().keys() == {*RUN, *ELSEWHERE}
    assert [name for name, words in examples().items() if words[:1] != [name]] == []


def test_the_examples_run(motionkit: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for variable in ("STORE", "RUNS", "RESULTS", "CACHE"):
        monkeypatch.delenv(f"MOTIONKIT_{variable}", raising=False)
    for name, action in (("walk", "walk"), ("jump", "squat"), ("wave", "wave")):
        motion = capture(Fraction(60), action, 3.0)
        mk.write(replace(motion, captions=()), tmp_path / "takes" / f"{name}.bvh")
    for name in RUN:
        outcome = motionkit(*examples()[name])
        assert outcome.code == 0, (name, outcome.stderr)
    assert [path for path in ("out", "tests") if not (tmp_path / path).exists()] == []


def test_help_has_the_order_of_readme() -> None:
    blocks = re.findall(
        r"^```\n(.*?)^```",
        (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    )
    named = re.findall(r"^(?:motionkit|make) (\w+)", "".join(blocks), re.MULTILINE)
    listed = [name for name in dict.fromkeys(named) if name in COMMANDS]
    assert len(listed) > 6 and listed == sorted(listed, key=[*COMMANDS].index)


def test_no_help_text_is_read_as_markup() -> None:
    """Rich takes [words] in brackets for its own and drops them."""
    texts = [each.help for command in COMMANDS.values() for each in command.params if getattr(each, "help", "")]
    assert len(texts) > 50
    assert [text for text in texts if Text.from_markup(text).plain != text] == []


def test_versions(motionkit: Callable[..., Outcome]) -> None:
    assert motionkit("--version").stdout == f"motionkit {version('motionkit')}\n"


@pytest.mark.parametrize(("typed", "completed"), [("comp", {"compact", "complete"}), ("remove --wh", {"--where"})])
def test_bash_completes_commands_and_options(typed: str, completed: set[str]) -> None:
    words = f"motionkit {typed}"
    environment = {"_MOTIONKIT_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    script = "import sys; sys.argv[0] = 'motionkit'; from motionkit.cli.app import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", script], env=os.environ | environment, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == completed


Draw = Callable[..., str]
BAR, ERASED = "━", "\x1b[2K"


@pytest.fixture
def drawn(motionkit, monkeypatch: pytest.MonkeyPatch) -> Draw:
    """`drawn("ingest", folder, …)`: what the command draws where stderr is a terminal."""
    for name, value in {"FORCE_COLOR": "1", "TERM": "xterm", "COLUMNS": "200"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(stderr, "is_interactive", True)

    def run(*arguments: object) -> str:
        outcome = motionkit(*arguments, "--json")
        assert outcome.code == 0, outcome.stderr
        json.loads(outcome.stdout)
        assert ERASED in outcome.stderr and BAR not in outcome.stderr.rpartition(ERASED)[2], "a bar is left behind"
        return str(outcome.stderr)

    return run


def test_commands_on_stores(drawn: Draw, takes: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    for take in sorted(takes.iterdir()):
        assert "scanning" in drawn("ingest", take, "--store", store, "--workers", 1)
    assert "validate" in drawn("validate", "--store", store)
    assert "merge" in drawn("merge", tmp_path / "merged", store)
    assert "compact" in drawn("compact", "--store", store)
    assert "export" in drawn("export", tmp_path / "out", "--format", "npz", "--store", store)
    assert "read" in drawn("view", takes / "alpha.bvh", "--out", tmp_path / "page.html")
    text = drawn("complete", takes / "alpha.bvh", "--fps", 240, "--out", tmp_path / "completed")
    assert "complete" in text
