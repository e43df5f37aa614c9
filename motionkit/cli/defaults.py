"""Defaults of commands' options from motionkit.toml: a table per command, a key for each long option."""

import os
from collections.abc import Collection, Mapping
from typing import Any

import typer

from motionkit.core.errors import UsageError
from motionkit.core.plain_text import shown, suggestion
from motionkit.core.settings import FILE, KEYS, OPTIONAL_KEYS, read_settings


def defaults_of(app: typer.Typer, name: str, commands: Collection[str]) -> dict[str, Any]:
    """The defaults of the command `name` in motionkit.toml, as click's `default_map` for the app.

    `commands` are the names of all commands. Raises `UsageError` for unknown keys and invalid values.
    """
    settings, known = read_settings(), (*KEYS, *OPTIONAL_KEYS, *commands)
    for key, value in settings.items():
        if key not in known:
            raise UsageError(f"{FILE}: there is no setting and no command {shown(key)}{suggestion(key, known)}")
        if key in commands and not isinstance(value, dict):
            raise UsageError(f"{FILE}: {key} is a command, and its options stand in a table: [{key}]")
    if name not in settings or name not in commands:
        return {}
    command = typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]
    return {name: _defaults(name, command, settings[name])}


def _defaults(name: str, command: Any, stated: Mapping[str, Any]) -> dict[str, Any]:
    if hasattr(command, "commands"):
        return {key: _of_part(name, command.commands, key, value) for key, value in stated.items()}
    options = {
        spelling.removeprefix("--"): parameter
        for parameter in command.params
        if parameter.param_type_name == "option"
        for spelling in parameter.opts
    }
    found = {}
    for key, value in stated.items():
        plain = key.replace("_", "-")
        if plain not in options:
            raise UsageError(
                f"{FILE}: 'motionkit {name}' has no option {shown('--' + plain)}{suggestion(plain, options)}"
            )
        # Environment variables take precedence over the file.
        if f"MOTIONKIT_{plain.upper()}" not in os.environ or plain not in KEYS:
            found[options[plain].name] = _value(f"{FILE}: [{name.replace(' ', '.')}] {key}", options[plain], value)
    return found


def _of_part(name: str, parts: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """Defaults of a subcommand, such as `study make`."""
    if key not in parts or not isinstance(value, dict):
        tables = " and ".join(f"[{name}.{each}]" for each in parts)
        raise UsageError(f"{FILE}: options of 'motionkit {name}' stand in {tables}, and {shown(key)} is neither")
    return _defaults(f"{name} {key}", parts[key], value)


def _value(place: str, option: Any, value: Any) -> Any:
    """A value as on the command line."""
    if option.is_flag:
        if not isinstance(value, bool):
            raise UsageError(f"{place} is true or false, not {shown(value)}")
        return value
    values = value if option.multiple and isinstance(value, list) else [value]
    if not all(type(each) in (str, int, float) for each in values):
        raise UsageError(f"{place} takes a text or a number, not {shown(value)}")
    texts = [str(each) for each in values]
    return texts if option.multiple else texts[0]
