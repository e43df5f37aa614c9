"""`motionkit train`: train the stages of a model from a store into a run folder."""

import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from motionkit.cli.console import print_json, progress, say_next, stderr, stdout
from motionkit.cli.options import of_default
from motionkit.core.errors import UsageError
from motionkit.core.settings import default_path
from motionkit.store.sql import conjunction
from motionkit.training.config import apply_overrides, flatten, parse_override, unknown_setting
from motionkit.training.run import RunFolder, concerns
from motionkit.training.stage import Stage, StageContext, choose_stages, registered_stages


def train(
    stage: Annotated[str, typer.Option(help="One installed stage, or all of the model's in order.")] = "all",
    recipe: Annotated[str, typer.Option(help="Named configuration: nano, small, demo, base, paper.")] = "nano",
    store: Annotated[Path | None, typer.Option(help="Store to train from.", show_default="./store")] = None,
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")] = None,
    run: Annotated[str | None, typer.Option(help="This run's name; the recipe's by default.")] = None,
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
        bool, typer.Option("--resume", help="Go on where a run stopped; complete stages are kept.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Start again where a run exists.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 0,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda, cuda:1 …")] = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="Print the stages' summaries as JSON.")] = False,
) -> None:
    """Train a model's stages from a store into a run folder; Ctrl-C saves, --resume goes on exactly."""
    from motionkit.store.manifest import read_manifest

    if resume and overwrite:
        raise UsageError("--resume and --overwrite exclude each other")
    chosen = choose_stages(stage, registered_stages())
    configs = configure(chosen, recipe, overrides or [])
    if where:
        configs = narrowed(chosen, configs, where)
    store_path = store or default_path("store")
    read_manifest(store_path)  # a store that is missing is found before anything heavy is imported
    if where:
        _check_condition(store_path, where)
    folder = RunFolder((runs or default_path("runs")) / (run or recipe))
    context = StageContext(store_path, folder, recipe, seed=seed, resume=resume, overwrite=overwrite, device=device)
    summaries = _train_all(list(zip(chosen, configs, strict=True)), context, as_json)
    if summaries is None:
        return
    if as_json:
        print_json({"run": str(folder.path), "stages": summaries})
    elif stage == "all":
        named = "" if folder.path.name == "nano" else f" --run {shlex.quote(folder.path.name)}"
        say_next(f"motionkit eval --table 2{of_default('--store', store)}{of_default('--runs', runs)}{named}")


def _train_all(jobs: list[tuple[Stage[Any], Any]], context: StageContext, as_json: bool) -> list[dict[str, Any]] | None:
    """Train stages with their configurations in order; the summaries, on the first rank alone."""
    from motionkit.store.manifest import read_manifest
    from motionkit.training.ranks import joined_ranks

    fingerprint = read_manifest(context.store).fingerprint
    summaries: list[dict[str, Any]] = []
    with joined_ranks() as ranks, progress() as show:
        context = replace(context, on_progress=show)
        for stage, config in jobs:
            ranks.on_first(partial(_check, stage, context, config, fingerprint))
        for stage, config in jobs:
            # Again, since a stage that it builds on may just have been trained.
            ranks.on_first(partial(_check_kept, stage, context, config, fingerprint))
            _train_stage(stage, config, replace(context, shared=stage.shared), is_first=ranks.is_first)
            if stage.shared:
                ranks.wait()  # for what the first one saves at last: the next stage reads it
            if not ranks.is_first:
                continue
            summary = context.run.stage(stage.name).read_summary()
            summaries.append({"stage": stage.name, **summary})
            if not as_json:
                figures = ", ".join(f"{name} {_short(value)}" for name, value in summary.items())
                stdout.print(f"{stage.name}: {figures}")
    return summaries if ranks.is_first else None


def _check(stage: Stage[Any], context: StageContext, config: Any, store_fingerprint: str) -> None:
    _check_kept(stage, context, config, store_fingerprint)
    stage.check(context, config)


def _check_kept(stage: Stage[Any], context: StageContext, config: Any, store_fingerprint: str) -> None:
    if context.resume and context.run.stage(stage.name).is_complete:
        stage.check_kept(context, config, store_fingerprint)


def _check_condition(store: Path, where: str) -> None:
    # Some stages ask for their sequences late: after others have trained, or after minutes of their own.
    from motionkit.store import Store

    if not Store.open(store).select(where).size:
        raise UsageError(f"--where: {where!r} holds for no sequence of the store {store}")


def configure(stages: tuple[Stage[Any], ...], recipe: str, overrides: list[str]) -> list[Any]:
    """Each stage's configuration; an override goes to every stage that has the setting, and one must have it."""
    configs = [stage.recipe(recipe) for stage in stages]
    for override in overrides:
        key, _ = parse_override(override)
        if not any(key in flatten(config) for config in configs):
            of = f" --stage {stages[0].name}" if len(stages) == 1 else ""
            raise UsageError(f"{unknown_setting(key, configs)}; 'motionkit recipe {recipe}{of}' lists all")
    return [
        apply_overrides(config, [override for override in overrides if parse_override(override)[0] in flatten(config)])
        for config in configs
    ]


def narrowed(stages: tuple[Stage[Any], ...], configs: list[Any], where: str) -> list[Any]:
    """Configurations whose settings called `where`, conditions on the store's sequences, hold the given one as well.

    Raises `UsageError` where no stage has one of its own: nothing would be left out.
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


def _train_stage(stage: Stage[Any], config: Any, context: StageContext, *, is_first: bool) -> None:
    folder = context.run.stage(stage.name)
    complete = context.resume and folder.is_complete
    if is_first:
        doing = "complete already, kept" if complete else f"{stage.description} → {folder.path}"
        stderr.print(f"{stage.name}: {doing}")
    if not complete and (stage.shared or is_first):
        stage.train(context, config)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
