"""`motionkit ablate`: train the variants of an ablation table."""

from pathlib import Path
from typing import Annotated, Any

import typer

from eval.tables.ablation_runs import find_ablation, find_ablations, papers_with_ablations, run_name, train_variant
from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import default_path
from motionkit.training.ablations import Ablation, Ablations, Variant
from motionkit.training.run import RunFolder, StageContext


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
        typer.Option("--set", metavar="KEY=VALUE", help="A setting of every variant (train --show lists them)."),
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
    names = list(ablations.tables) if "all" in (tables or ()) else list(dict.fromkeys(tables or ()))
    chosen = [find_ablation(ablations, name) for name in names]
    # Runs of models other than the default one have the paper in their names.
    named = recipe if ablations.is_default else f"{ablations.paper}-{recipe}"
    folder, prefix = runs or default_path("runs"), run or named
    if listing:
        _list(chosen or list(ablations.tables.values()), folder, prefix, seed, as_json)
        return
    if not chosen:
        known = ", ".join(ablations.tables)
        raise UsageError(f"name a table: {known}, or all (motionkit ablate --list says what they vary)")
    variants = _variants(ablations, chosen, only, stage)
    if recipe not in ablations.recipes:
        raise UsageError(f"there is no recipe {recipe!r}: {', '.join(ablations.recipes)}")
    base = ablations.recipes[recipe]()
    configs = {variant: variant.configure(base, overrides or [], where) for variant in variants}

    from motionkit.store.commit import read_manifest

    store = store or default_path("store")
    read_manifest(store)  # fail on a missing store before heavy imports
    trained = []
    with progress() as show:
        common = StageContext(
            store,
            RunFolder(folder / prefix),
            recipe,
            seed=seed,
            resume=not overwrite,
            overwrite=overwrite,
            device=device,
            on_progress=show,
        )
        for number, (variant, stages) in enumerate(variants.items(), start=1):
            stderr.print(f"{number} of {len(variants)}: {run_name(prefix, variant, seed)}")
            try:
                trained.append(train_variant(ablations, common, variant, configs[variant], stages))
            except MotionkitError as error:
                # The others are trained all the same.
                stderr.print(f"motionkit: {variant.name}: {error}")
                continue
            if not as_json:
                _print_outcome(trained[-1])
    if as_json:
        print_json({"runs": str(folder), "trained": trained})
    if len(trained) < len(variants):
        failed = len(variants) - len(trained)
        raise MotionkitError(f"{failed} of {len(variants)} variants failed; the same command tries again")


def _variants(
    ablations: Ablations, chosen: list[Ablation], only: str | None, stage: str
) -> dict[Variant, tuple[str, ...]]:
    """Every variant of the tables once, with all stages that it needs."""
    first = next(iter(ablations.stages))
    if stage not in ("all", first):
        raise UsageError(f"--stage {stage}: all or {first}")
    stages: dict[Variant, tuple[str, ...]] = {}
    for ablation in chosen:
        for variant in ablation.variants:
            needed = ablation.stages if stage == "all" else (first,)
            stages[variant] = max(stages.get(variant, ()), needed, key=len)
    if only is None:
        return stages
    known = {variant.name: variant for variant in stages}
    names = [name.strip() for name in only.split(",")]
    for name in names:
        if name not in known:
            raise UsageError(f"--only {name}: no such variant in the tables named; there are: {', '.join(known)}")
    return {known[name]: stages[known[name]] for name in names}


def _print_outcome(outcome: dict[str, Any]) -> None:
    losses = ", ".join(f"{name} loss {summary['loss']:.4g}" for name, summary in outcome["stages"].items())
    stdout.print(f"{outcome['run']}: {losses}, {outcome['cpu_seconds']:.0f} CPU seconds")


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
