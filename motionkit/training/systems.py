"""What a table of systems needs to be trained: the stages of each, in order, and each one's part of a budget.

A system is a model or encoder that tables load from runs (`motionkit.training.loaders`). A table is an entry point of
the group `motionkit.tables`, called PAPER-NUMBER; it says which systems it has rows of.
"""

from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any, Protocol, runtime_checkable

from motionkit.core.errors import UsageError
from motionkit.training.loaders import Loader
from motionkit.training.run import RunError, RunFolder, StageFolder
from motionkit.training.stage import Stage

TABLES = "motionkit.tables"
KINDS = {"table": "", "figure": "figure"}


@runtime_checkable
class ShowsSystems(Protocol):
    """A table with rows of what is trained."""

    @property
    def shown(self) -> Callable[[], Mapping[str, Loader[Any]]]:
        """Gives the loaders of its rows by name."""
        ...

    @property
    def reads(self) -> tuple[str, ...]:
        """Other stages of the run that it reads: evaluators."""
        ...

    @property
    def settings(self) -> tuple[str, ...]:
        """What its systems are trained with, KEY=VALUE, where nothing else is asked for."""
        ...


@dataclass(frozen=True)
class Needed:
    """Stages in the order in which they are trained; `parts` are those of systems with their parts of one system's
    budget, which add up to 1 for each."""

    stages: tuple[Stage[Any], ...]
    parts: Mapping[str, float]

    def budgets(self, seconds: float | None) -> dict[str, float | None]:
        """Each stage's processor seconds where each system has so many; evaluators have none."""
        return {
            stage.name: None if seconds is None or stage.name not in self.parts else seconds * self.parts[stage.name]
            for stage in self.stages
        }


def table_that_shows(paper: str | None, wanted: str) -> ShowsSystems:
    """The table of a paper that "table:2" or "figure:8" names; raises `UsageError` with those there are.

    Of papers with such a table the one whose tables are the default's where none is named.
    """
    kind, colon, number = wanted.partition(":")
    if not (colon and number and kind in KINDS):
        raise UsageError(f"--for {wanted}: table:NUMBER or figure:NUMBER, such as table:2")
    known = sorted(entry_points(group=TABLES), key=lambda entry: entry.name)
    asked = "" if paper is None else paper
    found = [
        entry.load()
        for entry in known
        if entry.name.endswith(f"-{KINDS[kind]}{number}") and entry.name.startswith(asked and f"{asked}-")
    ]
    if not found:
        names = ", ".join(entry.name for entry in known)
        raise UsageError(f"--for {wanted}: there is no such table; installed tables: {names or 'none'}")
    table = next((each for each in found if getattr(each, "is_default", False)), found[0])
    if not isinstance(table, ShowsSystems) or not table.shown():
        raise UsageError(f"--for {wanted}: that table has no rows of systems (of ablations: motionkit ablate)")
    return table


def stages_for(
    table: ShowsSystems,
    stages: Mapping[str, Stage[Any]],
    earlier_of: Callable[[str], Iterable[str]],
    kept: Callable[[str], bool],
) -> Needed:
    """All stages that a table's systems need, those that others build on before them.

    Of a stage that is `kept` nothing before it is needed; its system's parts are the same. Raises `UsageError` for a
    stage that is not installed.
    """
    for loader in table.shown().values():
        for name in loader.stages:
            if name not in stages:
                raise UsageError(f"no stage is called {name!r}; there are: {', '.join(stages)}")

    def needed(name: str) -> Iterable[str]:
        return () if kept(name) else earlier_of(name)

    parts: dict[str, float] = {}
    wanted = _with_earlier([name for name in table.reads if name in stages], needed)
    for loader in table.shown().values():
        wanted |= _with_earlier(loader.stages, needed)
        own = _with_earlier(loader.stages, earlier_of)
        whole = sum(stages[name].share for name in own)
        for name in own:
            # A stage of two systems is trained for the longer of its times.
            parts[name] = max(parts.get(name, 0.0), stages[name].share / whole)
    ordered = sorted(wanted, key=lambda name: (stages[name].order, name))
    return Needed(tuple(stages[name] for name in ordered), parts)


def _with_earlier(names: Iterable[str], earlier_of: Callable[[str], Iterable[str]]) -> set[str]:
    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += earlier_of(name)
    return found


def check_comparable(
    folder: StageFolder, store_fingerprint: str, budget_seconds: float | None, to_train: Container[str] = ()
) -> None:
    """Raise `RunError` where a complete stage was trained on another store, upon another stage than the run has or will
    have when those `to_train` are trained, or to another budget than is asked for."""
    begun, run = folder.read_config(), RunFolder(folder.path.parent)
    command = f"motionkit train --stage {folder.path.name} --run {run.path.name} --overwrite"
    again = f"train it again ({command}), or use another --run"
    for name, sha256 in begun.get("builds_on", {}).items():
        if name in to_train or run.fingerprints([name]).get(name, sha256) != sha256:
            raise RunError(f"{folder.path} was trained upon another {name} than this run's: {again}")
    if begun.get("store_fingerprint") != store_fingerprint:
        raise RunError(f"{folder.path} was trained on another store, or on another state of it: {again}")
    if budget_seconds is not None and begun.get("budget_seconds") != budget_seconds:
        had = begun.get("budget_seconds")
        told = "without a budget" if had is None else f"with a budget of {had:g} s"
        raise RunError(f"{folder.path} was trained {told}, not with one of {budget_seconds:g} s: {again}")


def is_kept(run: RunFolder) -> Callable[[str], bool]:
    """Whether a stage, by its name, is complete in a run."""
    return lambda name: run.stage(name).is_complete


def options_for(wanted: str, paper: str | None) -> tuple[str, str]:
    """The options of `motionkit train`, and of the command that builds tables, for what `--for` names."""
    of_paper = "" if paper is None else f" --paper {paper}"
    return f"--for {wanted}{of_paper}", f"--{wanted.replace(':', ' ')}{of_paper}"
