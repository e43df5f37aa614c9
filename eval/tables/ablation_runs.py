"""The runs of ablation tables: which models declare ablations, how runs are called, and how a variant is trained."""

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.training.ablations import Ablation, Ablations, Variant
from motionkit.training.run import RunFolder, StageContext


def papers_with_ablations() -> tuple[str, ...]:
    """The papers of all installed ablations, sorted."""
    return plugins.names("ABLATIONS")


def find_ablations(paper: str | None = None) -> Ablations:
    """The ablations of a paper's model, or the default ones; raises `UsageError` that lists the known papers."""
    for name in papers_with_ablations():
        if paper in (None, name):
            ablations: Ablations = plugins.load("ABLATIONS", name)
            if paper is not None or ablations.is_default:
                return ablations
    problem = f"there are no ablations of {paper!r}" if paper else "name a paper with --paper"
    raise UsageError(f"{problem}; of: {', '.join(papers_with_ablations()) or 'none'}")


def find_ablation(ablations: Ablations, table: str) -> Ablation:
    """The ablation of a table; raises `UsageError` that lists the known ones."""
    if table not in ablations.tables:
        known = ", ".join(f"{name} ({ablation.title})" for name, ablation in ablations.tables.items())
        raise UsageError(f"there is no ablation {table!r} of {ablations.paper!r}; there are: {known}, or all")
    return ablations.tables[table]


def run_name(prefix: str, variant: Variant, seed: int) -> str:
    """The run of one variant: PREFIX-VARIANT, and -seedN after it for any seed but 0."""
    return f"{prefix}-{variant.name}" + (f"-seed{seed}" if seed else "")


def ablate_command(ablations: Ablations, table: str, prefix: str, variant: Variant) -> str:
    """The command that trains one variant of a table."""
    paper = "" if ablations.is_default else f" --paper {ablations.paper}"
    return f"motionkit ablate {table}{paper} --run {prefix} --only {variant.name}"


def trained_runs(ablations: Ablations, table: str, prefix: Path | None, stage: str) -> dict[str, dict[int, RunFolder]]:
    """The runs of a table's entries, by the entry's name and the seed, in which a stage is complete.

    Raises `UsageError` without the runs' prefix, or if none is trained.
    """
    if prefix is None:
        raise UsageError("an ablation table needs the name of its runs: --run NAME for runs/NAME-VARIANT")
    ablation, runs = ablations.tables[table], {}
    for entry in ablation.entries:
        named = {seed: RunFolder(prefix.with_name(run_name(prefix.name, entry.variant, seed))) for seed in range(100)}
        runs[entry.name] = {seed: run for seed, run in named.items() if run.stage(stage).is_complete}
    if not any(runs.values()):
        paper = "" if ablations.is_default else f" --paper {ablations.paper}"
        names = ", ".join(run_name(prefix.name, variant, 0) for variant in ablation.variants)
        raise UsageError(
            f"no run of this table is trained in {str(prefix.parent)!r}: motionkit ablate {table}{paper} --run "
            f"{prefix.name} trains {names}"
        )
    return runs


def train_variant(
    ablations: Ablations, common: StageContext, variant: Variant, config: Any, stages: Sequence[str]
) -> dict[str, Any]:
    """Train a variant's missing stages; returns its run's name, each stage's summary and the CPU seconds.

    `common` has the run's common options; its own run, RUNS/PREFIX, has what all variants share. Complete stages are
    kept. Raises `RunError` if they were trained with other settings, `BusyError` while another process trains one of
    them, and what training raises.
    """
    from motionkit.store.commit import read_manifest  # this module is read for --help

    run = RunFolder(common.run.path.with_name(run_name(common.run.path.name, variant, common.seed)))
    context = replace(common, run=run)
    started = time.process_time()
    summaries = {}
    with ExitStack() as locks:
        for name in stages:
            locks.enter_context(run.stage(name).locked())
        # What is shared has one seed, and is never replaced.
        ablations.prepare(replace(common, seed=0, resume=True, overwrite=False), run, config)
        for name in stages:
            folder, stage = run.stage(name), ablations.stages[name]
            if folder.is_complete and not common.overwrite:
                stage.check_kept(context, config, read_manifest(common.store).fingerprint)
            else:
                stage.train(context, config)
            summaries[name] = folder.read_summary()
    return {
        "run": run.path.name,
        "variant": variant.name,
        "stages": summaries,
        "cpu_seconds": round(time.process_time() - started, 1),
    }
