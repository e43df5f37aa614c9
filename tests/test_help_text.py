"""What the command line says of itself: help texts as they are written, and the installed version."""

from importlib.metadata import version
from pathlib import Path

import typer
from rich.text import Text
from typer.testing import CliRunner

from motionkit.cli.app import build_app
from motionkit.core.errors import StoreError


def test_no_help_text_is_read_as_markup() -> None:
    """Rich takes [words] in brackets for its own and drops them."""
    app = typer.main.get_command(build_app())
    assert isinstance(app, typer.core.TyperGroup)
    commands = dict(app.commands)
    for group in [each for each in app.commands.values() if isinstance(each, typer.core.TyperGroup)]:
        commands |= group.commands
    texts = [
        (name, parameter.name, parameter.help)
        for name, command in commands.items()
        for parameter in command.params
        if isinstance(parameter, typer.core.TyperOption | typer.core.TyperArgument) and parameter.help
    ]
    assert len(texts) > 50
    assert [told for told in texts if Text.from_markup(told[-1]).plain != told[-1]] == []


def test_the_version_is_the_distributions() -> None:
    result = CliRunner().invoke(build_app(), ["--version"], catch_exceptions=False)
    assert (result.exit_code, result.stdout) == (0, f"motionkit {version('motionkit')}\n")


def test_commands_run_beside_the_apps_own_options(tmp_path: Path) -> None:
    result = CliRunner().invoke(build_app(), ["info", "--store", str(tmp_path / "none")])
    assert isinstance(result.exception, StoreError), result.exception
