"""`motionkit ablate`: train the variants of an ablation table."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.cli.train import narrowed
from motionkit.core import plugins
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import default_path
from motionkit.training.ablations import Ablation, Ablations, Variant, find_ablations, run_of
from motionkit.training.run import RunFolder, StageContext


def ablate(
    tables: Annotated[list[str] | None, typer.Argument(help="Tables of the paper: 5, figure6 …; or all.")] = None,
    listing: Annotated[
        bool, typer.Option("--list", help="Print the variants and what is trained; train nothing.")
    ] = False,
    only: Annotated[
        str | None, typer.Option(metavar="NAME,…", help="These variants alone (--list names them).")
    ] = None,
    paper: Annotated[
        str | None, typer.Option(help=f"Paper whose model is varied: {', '.join(plugins.names('ABLATIONS'))}.")
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
    names = list(ablations.tables) if tables == ["all"] or (listing and not tables) else tables or []
    for name in names or [""]:
        if name not in ablations.tables:
            known = ", ".join(f"{table} ({each.title})" for table, each in ablations.tables.items())
            raise UsageError(f"there is no ablation {name!r} of {ablations.paper!r}; name a table: {known}, or all")
    chosen = [ablations.tables[name] for name in names]
    # Runs of models other than the default one have the paper in their names.
    named = recipe if ablations.is_default else f"{ablations.paper}-{recipe}"
    prefix = (runs or default_path("runs")) / (run or named)
    if listing:
        for ablation in chosen:
            for variant in ablation.variants:
                state = [name for name in ablation.stages if run_of(prefix, variant, seed).stage(name).is_complete]
                settings, trained = " ".join(variant.change) or "the recipe's own settings", " and ".join(state)
                stdout.print(f"{ablation.table:8} {variant.name:24} {settings:40} {trained or 'not trained'}")
        return
    variants = _variants(ablations, chosen, only, stage)
    first = next(iter(ablations.stages.values()))
    base = first.recipe(recipe)
    configs = [variant.configure(base, overrides or []) for variant in variants]
    if where:
        configs = [narrowed((first,), [config], where)[0] for config in configs]

    from motionkit.store.commit import read_manifest

    store = store or default_path("store")
    read_manifest(store)  # fails for a missing store before heavy imports
    outcomes = []
    with progress() as show:
        common = StageContext(
            store,
            RunFolder(prefix),
            recipe,
            seed=seed,
            resume=not overwrite,
            overwrite=overwrite,
            device=device,
            on_progress=show,
        )
        for number, ((variant, stages), config) in enumerate(zip(variants.items(), configs, strict=True), start=1):
            run_folder = run_of(prefix, variant, seed)
            stderr.print(f"{number} of {len(variants)}: {run_folder.path.name}")
            try:
                summaries = _train(ablations, common, run_folder, config, stages)
            except MotionkitError as error:
                # The others are trained all the same.
                stderr.print(f"motionkit: {variant.name}: {error}")
                continue
            outcomes.append({"run": run_folder.path.name, "variant": variant.name, "stages": summaries})
            if not as_json:
                losses = ", ".join(f"{name} loss {summary['loss']:.4g}" for name, summary in summaries.items())
                stdout.print(f"{run_folder.path.name}: {losses}")
    if as_json:
        print_json({"runs": str(prefix.parent), "trained": outcomes})
    if len(outcomes) < len(variants):
        failed = len(variants) - len(outcomes)
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
    known = {variant.name: variant for variant in stages}
    names = list(known) if only is None else [name.strip() for name in only.split(",")]
    if unknown := [name for name in names if name not in known]:
        raise UsageError(f"--only {unknown[0]}: no such variant in these tables; there are: {', '.join(known)}")
    return {known[name]: stages[known[name]] for name in names}


def _train(
    ablations: Ablations, common: StageContext, run: RunFolder, config: Any, stages: tuple[str, ...]
) -> dict[str, Any]:
    """Train a variant's missing stages in its run; returns each stage's summary.

    `common` is the context of RUNS/PREFIX, which has what all variants share.
    """
    from motionkit.store.commit import read_manifest

    context = replace(common, run=run)
    summaries = {}
    with ExitStack() as locks:
        for name in stages:
            locks.enter_context(context.run.stage(name).locked())
        # What is shared has one seed, and is never replaced.
        ablations.prepare(replace(common, seed=0, resume=True, overwrite=False), context.run, config)
        for name in stages:
            folder, stage = context.run.stage(name), ablations.stages[name]
            if folder.is_complete and not context.overwrite:
                stage.check_kept(context, config, read_manifest(common.store).fingerprint)
            else:
                stage.train(context, config)
            summaries[name] = folder.read_summary()
    return summaries
