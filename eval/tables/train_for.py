"""The stages to train for a table of systems, in order, and their shares of a time budget: `motionkit train --for`."""

from collections.abc import Iterable, Sequence
from typing import Any

from eval.tables.table import Table
from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.training.run import Stage, StageContext, StagePlan


def plan(target: str, paper: str | None, context: StageContext, overrides: Sequence[str]) -> StagePlan:
    """The stages that a table's systems need ("table:2", "figure:8"), as `PLANS` of `motionkit.core.plugins` has it.

    A complete stage of the run is kept, unless the context overwrites: it needs no earlier ones, and its system's
    shares are unchanged. Raises `UsageError` for an unknown table.
    """
    table = table_that_shows(paper, target)
    stages: dict[str, Stage[Any]] = plugins.load_all("STAGES")

    def with_earlier(names: Iterable[str], *, of_kept: bool) -> set[str]:
        """The stages and all that they build on; with `of_kept` also what complete ones were built on."""
        needed: set[str] = set()
        waiting = list(names)
        while waiting:
            name = waiting.pop()
            stage, folder = stages[name], context.run.stage(name)
            if name not in needed and (context.overwrite or not folder.is_complete):
                waiting += stage.builds_on(stage.configured(context.recipe, (*table.settings, *overrides)))
            elif name not in needed and of_kept:
                waiting += folder.read_config().get("builds_on", {})
            needed.add(name)
        return needed

    shares: dict[str, float] = {}
    needed = with_earlier([name for name in table.reads if name in stages], of_kept=False)
    for system in table.shown().values():
        needed |= with_earlier(system.stages, of_kept=False)
        own = with_earlier(system.stages, of_kept=True)
        total = sum(stages[name].share for name in own)
        # A stage of two systems gets the larger share.
        shares |= {name: max(shares.get(name, 0.0), stages[name].share / total) for name in own}
    return StagePlan(
        tuple(stage for name, stage in stages.items() if name in needed),
        shares,
        settings=table.settings,
        next_command=f"motionkit eval --{target.replace(':', ' ')}{'' if paper is None else f' --paper {paper}'}",
    )


def table_that_shows(paper: str | None, target: str) -> Table:
    """The table of a paper named by "table:2" or "figure:8", without a paper of the default one if it has it.

    Raises `UsageError` for a table without rows of systems.
    """
    known: dict[str, Table] = plugins.load_all("TABLES")
    named = [each for each in known.values() if each.target == target and paper in (None, each.paper)]
    if not named:
        raise UsageError(f"--for {target}: table:NUMBER or figure:NUMBER of the installed tables: {', '.join(known)}")
    table = max(named, key=lambda table: table.is_default)
    if not table.shown():
        raise UsageError(f"--for {target}: that table has no rows of systems (of ablations: motionkit ablate)")
    return table
