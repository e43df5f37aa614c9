"""`motionkit ablate`: train the variants of an ablation table."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.console import AsJson, RunsFolder, print_json, progress, stderr, stdout
from motionkit.cli.train import Job, narrowed, train_all
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import default_path
from motionkit.training.ablations import Variant, find_ablations, run_of
from motionkit.training.run import RunFolder, StageContext


def ablate(
    tables: Annotated[list[str] | None, typer.Argument(help="Tables of the paper: 5, figure6 …; or all.")] = None,
    listing: Annotated[bool, typer.Option("--list", help="Print the variants and what is trained.")] = False,
    only: Annotated[str | None, typer.Option(metavar="NAME,…", help="These variants alone (see --list).")] = None,
    paper: Annotated[str | None, typer.Option(help="Paper whose model is varied: nerm, pahires.")] = None,
    recipe: Annotated[str, typer.Option(help="Recipe that is varied: nano, small, demo, base, paper.")] = "nano",
    store: Annotated[Path | None, typer.Option(help="Store to train from.", show_default="./store")] = None,
    runs: RunsFolder = None,
    run: Annotated[str | None, typer.Option(help="Runs are called RUN-VARIANT; the recipe's name by default.")] = None,
    stage: Annotated[str, typer.Option(help="all that the table needs, or the first by its name.")] = "all",
    overrides: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="As for train.")] = None,
    where: Annotated[str | None, typer.Option(metavar="SQL", help="Only sequences for which this holds.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Train again what is complete.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Any but 0 makes runs of its own, RUN-VARIANT-seedN.")] = 0,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda, cuda:1 …")] = "auto",
    as_json: AsJson = False,
) -> None:
    """Train all variants of an ablation, a run each; complete ones are kept, stopped ones resumed.

    Example: motionkit ablate 5 --list
    """
    from motionkit.store.commit import read_manifest  # deferred: help loads no numpy

    ablations = find_ablations(paper)
    names = list(ablations.tables) if tables == ["all"] or (listing and not tables) else tables or []
    for name in names or [""]:
        if name not in ablations.tables:
            titles = ", ".join(f"{table} ({each.title})" for table, each in ablations.tables.items())
            raise UsageError(f"there is no ablation {name!r} of {ablations.paper!r}; name a table: {titles}, or all")
    # Runs of models other than the default one have the paper in their names.
    named = recipe if ablations.is_default else f"{ablations.paper}-{recipe}"
    prefix = (runs or default_path("runs")) / (run or named)
    first = next(iter(ablations.stages))
    if stage not in ("all", first):
        raise UsageError(f"--stage {stage}: all or {first}")
    # Every variant once, with all stages that it needs.
    stages: dict[Variant, tuple[str, ...]] = {}
    for name in names:
        needed = ablations.tables[name].stages if stage == "all" else (first,)
        for variant in ablations.tables[name].variants:
            stages[variant] = max(stages.get(variant, ()), needed, key=len)
            if listing:
                state = [each for each in needed if run_of(prefix, variant, seed).stage(each).is_complete]
                settings, trained = " ".join(variant.change) or "the recipe's own settings", " and ".join(state)
                stdout.print(f"{name:8} {variant.name:24} {settings:40} {trained or 'not trained'}")
    if listing:
        return
    if only is not None:
        known = {variant.name: variant for variant in stages}
        if unknown := [name for name in only.split(",") if name not in known]:
            raise UsageError(f"--only {unknown[0]}: no such variant in these tables; there are: {', '.join(known)}")
        stages = {known[name]: stages[known[name]] for name in only.split(",")}
    base = ablations.stages[first].configured(recipe)
    configs = [variant.configure(base, overrides or []) for variant in stages]
    if where:
        configs = [narrowed((ablations.stages[first],), [config], where)[0] for config in configs]
    store = store or default_path("store")
    context = StageContext(
        store, RunFolder(prefix), recipe, seed=seed, resume=not overwrite, overwrite=overwrite, device=device
    )
    read_manifest(store)  # fails for a missing store before anything is written
    trained_runs = []
    for (variant, needed), config in zip(stages.items(), configs, strict=True):
        run_folder = run_of(prefix, variant, seed)
        stderr.print(run_folder.path.name)
        try:
            with progress() as show:
                # What all variants share has one seed, and is never replaced.
                common = replace(context, seed=0, resume=True, overwrite=False, on_progress=show)
                ablations.prepare(common, run_folder, config)
            jobs = [Job(ablations.stages[name], config) for name in needed]
            summaries = train_all(jobs, replace(context, run=run_folder), as_json)
            trained_runs.append({"run": run_folder.path.name, "variant": variant.name, "stages": summaries})
        except MotionkitError as error:
            # The others are trained all the same.
            stderr.print(f"motionkit: {variant.name}: {error}")
    if as_json:
        print_json({"runs": str(prefix.parent), "trained": trained_runs})
    if failed := len(stages) - len(trained_runs):
        raise MotionkitError(f"{failed} of {len(stages)} variants failed; the same command tries again")
