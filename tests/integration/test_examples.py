"""The example in every command's help, run as it stands beside five takes."""

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest
import typer

import motionkit as mk
from motionkit.cli.app import build_app
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import analytic_motion
from tests.helpers.outcome import Outcome

# In the order in which a person would come to them.
BEFORE = ("ingest", "info", "split")
OF_STORES = (
    *(
        "validate",
        "query",
        "view",
        "complete",
        "plant",
        "merge",
        "export",
        "samples",
        "study",
        "ablate",
    ),
    *("push", "remove", "compact"),
)
# These train first: test_from_takes_to_a_table runs such commands out of README, test_front_door the demo. What is
# pulled has to be pushed: test_hub. test_convert converts.
ELSEWHERE = ("train", "generate", "eval", "report", "demo", "pull", "convert")


def examples() -> dict[str, list[str]]:
    """The words behind `motionkit` of each command's example."""
    commands = typer.main.get_command(build_app()).commands  # type: ignore[attr-defined]
    found = {}
    for name, command in commands.items():
        lines = re.findall(r"^Example: motionkit (.*)$", command.help, re.MULTILINE)
        found[name] = shlex.split(lines[0]) if len(lines) == 1 else []
    return found


def test_every_command_has_one_of_its_own() -> None:
    found = examples()
    assert found.keys() == {*BEFORE, *OF_STORES, *ELSEWHERE}
    assert [name for name, words in found.items() if words[:1] != [name]] == []


def test_they_do_what_they_say(
    motionkit: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for variable in ("STORE", "RUNS", "RESULTS", "CACHE"):
        monkeypatch.delenv(f"MOTIONKIT_{variable}", raising=False)
    for name, action in (("walk", "walk"), ("jump", "squat"), ("wave", "wave")):
        motion = to_motion(analytic_motion(action, 3.0), Fraction(60))
        mk.write(replace(motion, captions=()), tmp_path / "takes" / f"{name}.bvh")
    found = examples()
    for name in (*BEFORE, *OF_STORES):
        outcome = motionkit(*found[name])
        assert outcome.code == 0, (found[name], outcome.stderr)
    assert [path for path in ("out", "tests") if not (tmp_path / path).exists()] == []
