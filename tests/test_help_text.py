"""What `--help` says of an option is printed as it is written: rich takes [words] in brackets for its markup."""

import typer
from rich.text import Text

from motionkit.cli.app import build_app


def test_no_help_text_is_read_as_markup() -> None:
    app = typer.main.get_command(build_app())
    assert isinstance(app, typer.core.TyperGroup)
    texts = [
        (name, parameter.name, parameter.help)
        for name, command in app.commands.items()
        for parameter in command.params
        if isinstance(parameter, typer.core.TyperOption | typer.core.TyperArgument) and parameter.help
    ]
    assert len(texts) > 50
    assert [told for told in texts if Text.from_markup(told[-1]).plain != told[-1]] == []
