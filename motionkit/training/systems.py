"""The stages to train for a table of systems, in order, and their shares of a time budget.

A system is a model or encoder that tables load from runs (`motionkit.training.loaders`). A table is an entry point
PAPER-NUMBER of the group `motionkit.tables`, which lists the systems of its rows.
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
    """A table with rows of trained systems."""

    @property
    def shown(self) -> Callable[[], Mapping[str, Loader[Any]]]:
        """Returns the loaders of its rows by name."""
        ...

    @property
    def reads(self) -> tuple[str, ...]:
        """Other stages of the run that it uses, such as evaluators."""
        ...

    @property
    def settings(self) -> tuple[str, ...]:
        """What its systems are trained with, KEY=VALUE, where nothing else is asked for."""
        ...


@dataclass(frozen=True)
class Needed:
    """Stages in training order; `parts` are the systems' stages with their shares of a system's budget, which sum to 1
    for each system."""

    stages: tuple[Stage[Any], ...]
    parts: Mapping[str, float]

    def budgets(self, seconds: float | None) -> dict[str, float | None]:
        """Each stage's processor seconds for a budget per system; evaluators have none."""
        return {
            stage.name: None if seconds is None or stage.name not in self.parts else seconds * self.parts[stage.name]
            for stage in self.stages
        }


def table_that_shows(paper: str | None, wanted: str) -> ShowsSystems:
    """The table of a paper named by "table:2" or "figure:8"; raises `UsageError` that lists the known ones.

    Without a paper, the one with default tables is preferred.
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
    """All stages that a table's systems need, in order of dependency.

    A `kept` stage needs no earlier ones; its system's shares are unchanged. Raises `UsageError` for a stage that is not
    installed.
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
            # A stage of two systems gets the larger share.
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
    """Raise `RunError` if a complete stage was trained on another store, with another budget, or upon a stage that has
    changed or will be trained (`to_train`)."""
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
        budget = "without a budget" if had is None else f"with a budget of {had:g} s"
        raise RunError(f"{folder.path} was trained {budget}, not with one of {budget_seconds:g} s: {again}")


def is_kept(run: RunFolder) -> Callable[[str], bool]:
    """Whether a stage, by its name, is complete in a run."""
    return lambda name: run.stage(name).is_complete


def options_for(wanted: str, paper: str | None) -> tuple[str, str]:
    """Options of `motionkit train`, and of the command that makes tables, for a value of `--for`."""
    of_paper = "" if paper is None else f" --paper {paper}"
    return f"--for {wanted}{of_paper}", f"--{wanted.replace(':', ' ')}{of_paper}"
