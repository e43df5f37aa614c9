"""`motionkit recipe`: show a recipe's settings, or the differences of several."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from motionkit.cli.console import print_json, stdout
from motionkit.training.config import flatten, setting_text
from motionkit.training.stage import Stage, choose_stages, registered_stages


def recipe(
    names: Annotated[list[str] | None, typer.Argument(help="Recipes: nano, small, demo, base, paper.")] = None,
    stage: Annotated[str, typer.Option(help="One installed stage, or all of the model's.")] = "all",
    as_json: Annotated[bool, typer.Option("--json", help="Print the settings as JSON.")] = False,
) -> None:
    """Show a recipe's settings, each line as for train's --set; for several recipes, their differences.

    Example: motionkit recipe nano paper
    """
    wanted = list(dict.fromkeys(names or ["nano"]))
    stages = choose_stages(stage, registered_stages())
    settings = {name: _settings(stages, name) for name in wanted}
    keys = differing(settings) if len(wanted) > 1 else list(settings[wanted[0]])
    if as_json:
        print_json({name: {key: values[key] for key in keys if key in values} for name, values in settings.items()})
    elif len(wanted) == 1:
        for key in keys:
            stdout.print(f"{key}={setting_text(settings[wanted[0]][key])}")
    else:
        for line in _columns(keys, settings):
            stdout.print(line)


def differing(settings: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The keys that differ or that not all recipes have, in order of first appearance."""
    keys = dict.fromkeys(key for values in settings.values() for key in values)
    first, *others = settings.values()
    return [
        key
        for key in keys
        if any((key in values) != (key in first) or values.get(key) != first.get(key) for values in others)
    ]


def _settings(stages: Sequence[Stage[Any]], recipe: str) -> dict[str, Any]:
    return {key: value for each in stages for key, value in flatten(each.recipe(recipe)).items()}


def _columns(keys: Sequence[str], settings: Mapping[str, Mapping[str, Any]]) -> list[str]:
    rows = [["", *settings]]
    rows += [
        [key, *(setting_text(values[key]) if key in values else "" for values in settings.values())] for key in keys
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
