"""`motionkit train`: train the stages of a model, or all systems of a table, from a store into a run folder."""

import shlex
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from motionkit.cli.console import print_json, say_next
from motionkit.cli.options import StoreArgument, named_store, of_default, parse_duration
from motionkit.cli.tracking import tensorboard_events
from motionkit.cli.train_jobs import Job, train_all
from motionkit.core.errors import UsageError
from motionkit.core.settings import default_path
from motionkit.store.sql import conjunction
from motionkit.training.config import apply_overrides, flatten, parse_override, unknown_setting
from motionkit.training.run import RunFolder, concerns
from motionkit.training.stage import Stage, StageContext, choose_stages, registered_stages
from motionkit.training.systems import (
    Needed,
    check_comparable,
    is_kept,
    options_for,
    stages_for,
    table_that_shows,
)


def train(
    path: StoreArgument = None,
    stage: Annotated[str, typer.Option(help="One installed stage, or all of the model's in order.")] = "all",
    wanted: Annotated[
        str | None, typer.Option("--for", metavar="table:N", help="Instead: what this table, or figure:N, lacks.")
    ] = None,
    paper: Annotated[str | None, typer.Option(help="Paper whose table --for means.")] = None,
    recipe: Annotated[str, typer.Option(help="Named configuration: nano, small, demo, base, paper.")] = "nano",
    store: Annotated[Path | None, typer.Option(help="Store to train from.", show_default="./store")] = None,
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")] = None,
    run: Annotated[str | None, typer.Option(help="This run's name; the recipe's by default.")] = None,
    budget: Annotated[
        str | None, typer.Option(metavar="20m", help="Processor time of each system: as many steps as fit.")
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a setting: field.schedule.steps=100.")
    ] = None,
    where: Annotated[
        str | None,
        typer.Option(
            metavar="SQL",
            help="Train only on sequences for which this holds too: \"NOT list_contains(quality_flags, 'teleport')\".",
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on where a run stopped; complete stages are kept. --for always does.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Start again where a run exists.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 0,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda, cuda:1 …")] = "auto",
    track: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Curves for TensorBoard too, in FOLDER/RUN/STAGE (extra 'track')."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the stages' summaries as JSON.")] = False,
) -> None:
    """Train a model's stages from a store into a run folder; Ctrl-C saves, --resume continues exactly.

    Example: motionkit train --recipe nano --run nano"""
    if resume and overwrite:
        raise UsageError("--resume and --overwrite exclude each other")
    store = named_store(path, store)
    folder = RunFolder((runs or default_path("runs")) / (run or recipe))
    going_on = resume or (wanted is not None and not overwrite)
    context = StageContext(
        store or default_path("store"), folder, recipe, seed=seed, resume=going_on, overwrite=overwrite, device=device
    )
    asked = Asked(stage, wanted, paper, tuple(overrides or ()), where, budget)
    jobs = planned(asked, context)
    with tensorboard_events(track and track / folder.path.name) as on_metrics:
        summaries = train_all(jobs, replace(context, on_metrics=on_metrics), as_json, title=wanted)
    if summaries is None:
        return
    if as_json:
        print_json({"run": str(folder.path), "stages": summaries})
    elif stage == "all":
        named = "" if folder.path.name == "nano" else f" --run {shlex.quote(folder.path.name)}"
        shown = "--table 2" if wanted is None else options_for(wanted, paper)[1]
        say_next(f"motionkit eval {shown}{of_default('--store', store)}{of_default('--runs', runs)}{named}")


@dataclass(frozen=True)
class Asked:
    """What to train: a stage, all stages, or a table's systems; with which settings, on which data, for how long."""

    stage: str
    wanted: str | None
    paper: str | None
    overrides: tuple[str, ...]
    where: str | None
    budget: str | None


def planned(asked: Asked, context: StageContext) -> list[Job]:
    """The jobs, in order; raises errors that can be found without opening the store."""
    from motionkit.store.manifest import read_manifest

    if asked.wanted is not None:
        settings = table_that_shows(asked.paper, asked.wanted).settings
        asked = replace(asked, overrides=(*settings, *asked.overrides))
    kept = is_kept(context.run) if asked.wanted is not None and not context.overwrite else _nothing_kept
    needed = _needed(asked, context, kept)
    configs = _configs(needed, asked, context.recipe, kept)
    # Fail on a missing store before heavy imports.
    fingerprint = read_manifest(context.store).fingerprint
    if asked.where:
        _check_condition(context.store, asked.where)
    budgets = needed.budgets(_budget_seconds(asked))
    for each in needed.stages:
        if kept(each.name):
            check_comparable(context.run.stage(each.name), fingerprint, budgets[each.name], configs)
    return [
        Job(each, configs.get(each.name), budgets[each.name], needed.parts.get(each.name, each.share))
        for each in needed.stages
    ]


def _nothing_kept(name: str) -> bool:
    return False


def _needed(asked: Asked, context: StageContext, kept: Callable[[str], bool]) -> Needed:
    """The stages that `--stage` or `--for` selects."""
    stages = registered_stages()
    if asked.wanted is None:
        return Needed(choose_stages(asked.stage, stages), {asked.stage: 1.0})
    if asked.stage != "all":
        raise UsageError("--for trains what a table lacks, --stage one stage: give one of them")

    def earlier_of(name: str) -> Iterable[str]:
        if kept(name):
            return tuple(context.run.stage(name).read_config().get("builds_on", {}))
        return stages[name].builds_on(_configured(stages[name], context.recipe, list(asked.overrides)))

    return stages_for(table_that_shows(asked.paper, asked.wanted), stages, earlier_of, kept)


def _configs(needed: Needed, asked: Asked, recipe: str, kept: Callable[[str], bool]) -> dict[str, Any]:
    """The configurations of all stages that are not kept, by name.

    Overrides may be of kept stages too, so that the same command can be repeated.
    """
    stages = tuple(each for each in needed.stages if recipe in each.recipes or not kept(each.name))
    configs = configure(stages, recipe, list(asked.overrides))
    if asked.where:
        configs = narrowed(stages, configs, asked.where)
    return {each.name: config for each, config in zip(stages, configs, strict=True) if not kept(each.name)}


def _budget_seconds(asked: Asked) -> float | None:
    if asked.budget is None:
        return None
    if asked.wanted is None and asked.stage == "all":
        raise UsageError("--budget is for the systems of a table (--for table:2), or for one --stage")
    return parse_duration(asked.budget, "--budget")


def _check_condition(store: Path, where: str) -> None:
    # Check now: some stages select their sequences only after others have trained, or after minutes.
    from motionkit.store import Store

    if not Store.open(store).select(where).size:
        raise UsageError(f"--where: {where!r} holds for no sequence of the store {store}")


def configure(stages: tuple[Stage[Any], ...], recipe: str, overrides: list[str]) -> list[Any]:
    """Each stage's configuration; an override applies to every stage with the setting, of which there must be one."""
    configs = [_configured(stage, recipe, overrides) for stage in stages]
    for override in overrides:
        key, _ = parse_override(override)
        if not any(key in flatten(config) for config in configs):
            of = f" --stage {stages[0].name}" if len(stages) == 1 else ""
            raise UsageError(f"{unknown_setting(key, configs)}; 'motionkit recipe {recipe}{of}' lists all")
    return configs


def _configured(stage: Stage[Any], recipe: str, overrides: list[str]) -> Any:
    """A stage's configuration with the overrides of its settings."""
    config = stage.recipe(recipe)
    known = flatten(config)
    return apply_overrides(config, [override for override in overrides if parse_override(override)[0] in known])


def narrowed(stages: tuple[Stage[Any], ...], configs: list[Any], where: str) -> list[Any]:
    """Add a condition to the configurations' `where` settings, which select the store's sequences.

    Raises `UsageError` if no stage has such a setting.
    """
    conditions = [
        {key: value for key, value in flatten(config).items() if key.rpartition(".")[2] == "where"}
        for config in configs
    ]
    if not any(
        concerns(stage.name, key, config)
        for stage, config, found in zip(stages, configs, conditions, strict=True)
        for key in found
    ):
        names = ", ".join(stage.name for stage in stages)
        raise UsageError(f"--where: {names} takes its sequences from another stage; train that one with --where")
    return [
        apply_overrides(config, [f"{key}={conjunction(value, where)}" for key, value in found.items()])
        for config, found in zip(configs, conditions, strict=True)
    ]
