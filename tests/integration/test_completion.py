"""Shells complete the names of commands and options, and find how to."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = (sys.executable, "-c", "import sys; sys.argv[0] = 'motionkit'; from motionkit.cli.app import main; main()")


def asked(environment: dict[str, str], *arguments: str) -> str:
    done = subprocess.run(
        (*COMMAND, *arguments), env=os.environ | environment, capture_output=True, text=True, check=True
    )
    return done.stdout


@pytest.mark.parametrize(("typed", "completed"), [("comp", {"compact", "complete"}), ("remove --wh", {"--where"})])
def test_bash_completes_commands_and_options(typed: str, completed: set[str]) -> None:
    words = f"motionkit {typed}"
    position = str(len(words.split()) - 1)
    environment = {"_MOTIONKIT_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": position}
    assert set(asked(environment).split()) == completed


def test_the_script_for_a_shell_is_installed(tmp_path: Path) -> None:
    # Which shell it is would be found by looking at the processes above this one.
    environment = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1", "HOME": str(tmp_path)}
    said = asked(environment, "--install-completion", "bash")
    assert "completion installed" in said
    (script,) = (path for path in tmp_path.rglob("motionkit.sh"))
    assert "_MOTIONKIT_COMPLETE=complete_bash" in script.read_text(encoding="utf-8")
    assert str(script.relative_to(tmp_path)) in (tmp_path / ".bashrc").read_text(encoding="utf-8")
