"""The stages to train for a table of systems, in order, and their shares of a time budget: `motionkit train --for`.

A system is a model or encoder that tables load from runs (`motionkit.training.run`).
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from eval.tables.table import Table
from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.training.run import Stage, StageContext, StagePlan

KINDS = {"table": "", "figure": "figure"}


def plan(target: str, paper: str | None, context: StageContext, overrides: Sequence[str]) -> StagePlan:
    """The stages that a table's systems need ("table:2", "figure:8"), as `PLANS` of `motionkit.core.plugins` has it.

    A complete stage of the run is kept, unless the context overwrites: it needs no earlier ones, and its system's
    shares are unchanged. Raises `UsageError` for an unknown table, and for a stage that is not installed.
    """
    table = table_that_shows(paper, target)
    stages: dict[str, Stage[Any]] = plugins.load_all("STAGES")
    systems = list(table.shown().values())
    for name in (name for system in systems for name in system.stages):
        if name not in stages:
            raise UsageError(f"no stage is called {name!r}; there are: {', '.join(stages)}")

    def is_kept(name: str) -> bool:
        return not context.overwrite and context.run.stage(name).is_complete

    def earlier(name: str) -> Iterable[str]:
        if is_kept(name):
            return tuple(context.run.stage(name).read_config().get("builds_on", {}))
        return stages[name].builds_on(stages[name].configured(context.recipe, (*table.settings, *overrides)))

    def missing(name: str) -> Iterable[str]:
        return () if is_kept(name) else earlier(name)

    shares: dict[str, float] = {}
    needed = _with_earlier([name for name in table.reads if name in stages], missing)
    for system in systems:
        needed |= _with_earlier(system.stages, missing)
        own = _with_earlier(system.stages, earlier)
        whole = sum(stages[name].share for name in own)
        for name in own:
            # A stage of two systems gets the larger share.
            shares[name] = max(shares.get(name, 0.0), stages[name].share / whole)
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
    kind, _, number = target.partition(":")
    if not number or kind not in KINDS:
        raise UsageError(f"--for {target}: table:NUMBER or figure:NUMBER, such as table:2")
    installed = plugins.names("TABLES")
    tables: list[Table] = [
        plugins.load("TABLES", name)
        for name in installed
        if name.endswith(f"-{KINDS[kind]}{number}") and (paper is None or name.startswith(f"{paper}-"))
    ]
    if not tables:
        names = ", ".join(installed)
        raise UsageError(f"--for {target}: there is no such table; installed tables: {names or 'none'}")
    table = next((each for each in tables if each.is_default), tables[0])
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
