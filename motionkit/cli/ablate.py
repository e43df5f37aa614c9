"""`motionkit ablate`: train the variants of an ablation table."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.settings import default_path
from motionkit.training.ablations import (
    Ablation,
    Ablations,
    Sweep,
    Variant,
    find_ablations,
    papers_with_ablations,
    run_name,
)
from motionkit.training.run import RunFolder


def ablate(
    tables: Annotated[list[str] | None, typer.Argument(help="Tables of the paper: 5, figure6 …; or all.")] = None,
    listing: Annotated[bool, typer.Option("--list", help="Say what there is and what is trained; train nothing.")] = (
        False
    ),
    only: Annotated[
        str | None, typer.Option(metavar="NAME,…", help="These variants alone (--list names them).")
    ] = None,
    paper: Annotated[
        str | None, typer.Option(help=f"Paper whose model is varied: {', '.join(papers_with_ablations())}.")
    ] = None,
    recipe: Annotated[
        str, typer.Option(help="Named configuration that is varied: nano, small, demo, base, paper.")
    ] = "nano",
    store: Annotated[Path | None, typer.Option(help="Store to train from.", show_default="./store")] = None,
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")] = None,
    run: Annotated[str | None, typer.Option(help="Runs are called RUN-VARIANT; the recipe's name by default.")] = None,
    stage: Annotated[str, typer.Option(help="all that the table needs, or the first by its name.")] = "all",
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A setting of every variant (motionkit recipe lists them)."),
    ] = None,
    where: Annotated[
        str | None, typer.Option(metavar="SQL", help="Train only on sequences for which this holds too.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Train again what is complete.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Any but 0 makes runs of its own, RUN-VARIANT-seedN.")] = 0,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda, cuda:1 …")] = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="Print the runs' summaries as JSON.")] = False,
) -> None:
    """Train all variants of an ablation, a run each; complete ones are kept, stopped ones resumed.

    Example: motionkit ablate 5 --list
    """
    ablations = find_ablations(paper)
    chosen = [ablations.find(table) for table in _named(tables or [], ablations)]
    # Runs of models other than the default one have the paper in their names.
    named = recipe if ablations.is_default else f"{ablations.paper}-{recipe}"
    folder, prefix = runs or default_path("runs"), run or named
    if listing:
        _list(chosen or list(ablations.tables.values()), folder, prefix, seed, as_json)
        return
    if not chosen:
        known = ", ".join(ablations.tables)
        raise UsageError(f"name a table: {known}, or all (motionkit ablate --list says what they vary)")
    jobs = _jobs(ablations, chosen, only, stage)
    base = ablations.recipe(recipe)
    configs = {variant.name: variant.configure(base, overrides or [], where) for variant, _ in jobs}

    from motionkit.store.manifest import read_manifest

    store_path = store or default_path("store")
    read_manifest(store_path)  # fail on a missing store before heavy imports
    sweep = Sweep(store_path, folder, prefix, recipe, seed=seed, overwrite=overwrite, device=device)
    with progress() as show:
        trained = _train_all(ablations, replace(sweep, on_progress=show), jobs, configs, as_json)
    if as_json:
        print_json({"runs": str(folder), "trained": trained})
    if len(trained) < len(jobs):
        raise MotionkitError(f"{len(jobs) - len(trained)} of {len(jobs)} variants failed; the same command tries again")


def _named(tables: list[str], ablations: Ablations) -> list[str]:
    return list(ablations.tables) if "all" in tables else list(dict.fromkeys(tables))


def _jobs(
    ablations: Ablations, chosen: list[Ablation], only: str | None, stage: str
) -> list[tuple[Variant, tuple[str, ...]]]:
    """Every variant of the tables once, with all required stages."""
    first = next(iter(ablations.stages))
    if stage not in ("all", first):
        raise UsageError(f"--stage {stage}: all or {first}")
    stages: dict[Variant, tuple[str, ...]] = {}
    for ablation in chosen:
        for variant in ablation.variants:
            needed = ablation.stages if stage == "all" else (first,)
            stages[variant] = max(stages.get(variant, ()), needed, key=len)
    if only is None:
        return list(stages.items())
    names = [name.strip() for name in only.split(",")]
    known = {variant.name: variant for variant in stages}
    for name in names:
        if name not in known:
            raise UsageError(f"--only {name}: no such variant in the tables named; there are: {', '.join(known)}")
    return [(known[name], stages[known[name]]) for name in dict.fromkeys(names)]


def _train_all(
    ablations: Ablations,
    sweep: Sweep,
    jobs: list[tuple[Variant, tuple[str, ...]]],
    configs: dict[str, Any],
    as_json: bool,
) -> list[dict[str, Any]]:
    """All jobs in order; one that fails is reported on stderr and does not stop the others."""
    from motionkit.training.ablations import train_variant

    trained = []
    for number, (variant, stages) in enumerate(jobs, start=1):
        stderr.print(f"{number} of {len(jobs)}: {run_name(sweep.prefix, variant, sweep.seed)}")
        try:
            outcome = train_variant(ablations, sweep, variant, configs[variant.name], stages)
        except MotionkitError as error:
            stderr.print(f"motionkit: {variant.name}: {error}")
            continue
        trained.append(outcome)
        if not as_json:
            losses = ", ".join(f"{name} loss {summary['loss']:.4g}" for name, summary in outcome["stages"].items())
            stdout.print(f"{outcome['run']}: {losses}, {outcome['cpu_seconds']:.0f} CPU seconds")
    return trained


def _list(chosen: list[Ablation], runs: Path, prefix: str, seed: int, as_json: bool) -> None:
    rows = []
    for ablation in chosen:
        for entry in ablation.entries:
            name = run_name(prefix, entry.variant, seed)
            complete = [stage for stage in ablation.stages if RunFolder(runs / name).stage(stage).is_complete]
            rows.append(
                {
                    "table": ablation.table,
                    "row": entry.name,
                    "variant": entry.variant.name,
                    "settings": list(entry.variant.change),
                    "run": name,
                    "complete": complete,
                    "needed": list(ablation.stages),
                }
            )
    if as_json:
        print_json(rows)
        return
    for ablation in chosen:
        stdout.print(f"{ablation.table}: {ablation.title}")
        for row in (row for row in rows if row["table"] == ablation.table):
            state = " and ".join(row["complete"]) or "not trained"
            settings = " ".join(row["settings"]) or "the recipe's own settings"
            stdout.print(f"  {row['variant']:24} {settings:34} {state}")
