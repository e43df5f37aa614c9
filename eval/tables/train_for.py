"""The stages to train for a table of systems, in order, and their shares of a time budget: `motionkit train --for`."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from eval.tables.table import Table
from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.training.run import Stage, StageContext, StagePlan


def plan(target: str, paper: str | None, context: StageContext, overrides: Sequence[str]) -> StagePlan:
    """The stages that a table's systems need ("table:2", "figure:8"), as `PLANS` of `motionkit.core.plugins` has it.

    A complete stage of the run is kept, unless the context overwrites: it needs no earlier ones, and its system's
    shares are unchanged. Raises `UsageError` for an unknown table, and for a stage that is not installed.
    """
    table = table_that_shows(paper, target)
    stages: dict[str, Stage[Any]] = plugins.load_all("STAGES")
    systems = list(table.shown().values())
    if unknown := [name for system in systems for name in system.stages if name not in stages]:
        raise UsageError(f"no stage is called {unknown[0]!r}; there are: {', '.join(stages)}")

    def is_kept(name: str) -> bool:
        return not context.overwrite and context.run.stage(name).is_complete

    def earlier(name: str) -> Iterable[str]:
        if is_kept(name):
            return tuple(context.run.stage(name).read_config().get("builds_on", {}))
        return stages[name].builds_on(stages[name].configured(context.recipe, (*table.settings, *overrides)))

    def earlier_to_train(name: str) -> Iterable[str]:
        return () if is_kept(name) else earlier(name)

    shares: dict[str, float] = {}
    needed = _with_earlier([name for name in table.reads if name in stages], earlier_to_train)
    for system in systems:
        needed |= _with_earlier(system.stages, earlier_to_train)
        own = _with_earlier(system.stages, earlier)
        for name in own:
            # A stage of two systems gets the larger share.
            share = stages[name].share / sum(stages[each].share for each in own)
            shares[name] = max(shares.get(name, 0.0), share)
    of_paper = "" if paper is None else f" --paper {paper}"
    return StagePlan(
        tuple(stage for name, stage in stages.items() if name in needed),
        shares,
        settings=table.settings,
        next_command=f"motionkit eval --{target.replace(':', ' ')}{of_paper}",
    )


def table_that_shows(paper: str | None, target: str) -> Table:
    """The table of a paper named by "table:2" or "figure:8"; raises `UsageError` that lists the known ones.

    Without a paper, the one with default tables is preferred.
    """
    known: dict[str, Table] = plugins.load_all("TABLES")
    of_papers = [table for name, table in known.items() if paper in (None, name.partition("-")[0])]
    named = [table for table in of_papers if table.target == target]
    if not named:
        raise UsageError(f"--for {target}: table:NUMBER or figure:NUMBER of the installed tables: {', '.join(known)}")
    table = max(named, key=lambda table: table.is_default)
    if not table.shown():
        raise UsageError(f"--for {target}: that table has no rows of systems (of ablations: motionkit ablate)")
    return table


def _with_earlier(names: Iterable[str], earlier: Callable[[str], Iterable[str]]) -> set[str]:
    """The names, and all that they need."""
    needed: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in needed:
            needed.add(name)
            waiting += earlier(name)
    return needed
