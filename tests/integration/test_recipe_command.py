"""`motionkit recipe`: what it tells of one recipe makes that recipe of any other."""

import json

import pytest
import typer
from typer.testing import CliRunner

from motionkit.cli.recipe import recipe
from motionkit.cli.train import configure
from motionkit.core.errors import UsageError
from motionkit.training.stage import choose_stages, registered_stages


def told(*arguments: str) -> str:
    app = typer.Typer()
    app.command()(recipe)
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


@pytest.mark.parametrize("stage", ["all", "evaluator"])
def test_its_lines_make_the_recipe_of_another(stage: str) -> None:
    stages = choose_stages(stage, registered_stages())
    lines = told("nano", "--stage", stage).splitlines()
    assert configure(stages, "paper", lines) == configure(stages, "nano", [])
    assert configure(stages, "paper", []) != configure(stages, "nano", [])


def test_where_two_recipes_differ() -> None:
    differences = json.loads(told("nano", "paper", "--stage", "field", "--json"))
    assert differences["nano"]["field.schedule.steps"] == 8000
    assert differences["paper"]["field.schedule.steps"] is None
    assert "field.loss.kl_weight" not in differences["nano"]
    head, *rows = told("nano", "paper", "--stage", "field").splitlines()
    assert head.split() == ["nano", "paper"]
    assert ["field.schedule.steps", "8000", "none"] in [row.split() for row in rows]
    assert len(rows) == len(differences["nano"])


def test_recipes_and_stages_that_are_not_there_are_refused() -> None:
    with pytest.raises(UsageError, match="has no recipe 'huge'; it has: nano, small, demo, base, paper"):
        told("huge")
    with pytest.raises(UsageError, match="no stage is called 'huge'"):
        told("--stage", "huge")
