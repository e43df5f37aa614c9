"""Loaders of objects from runs, registered as entry points.

The entry point's module must import lightly (no torch at module level), since titles are listed without loading. A
plain function from a run folder works too: the entry point's name is then its title and its stage.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Generic, TypeVar

from motionkit.training.run import RunFolder

T = TypeVar("T")


@dataclass(frozen=True)
class Loader(Generic[T]):
    """A loader from the stages of a run.

    `title` is its name in tables and messages; `stages` are those it needs; loaders are sorted by `order`.
    """

    title: str
    stages: tuple[str, ...]
    load: Callable[[Path], T]
    order: int = 100

    def begun_in(self, run: Path) -> bool:
        """Whether a run holds at least one trained stage of it."""
        stages = [RunFolder(run).stage(name) for name in self.stages]
        return any(stage.is_complete or stage.model_path.is_file() for stage in stages)

    def complete_in(self, run: Path) -> bool:
        """Whether all its stages are trained in a run."""
        return all(RunFolder(run).stage(name).is_complete for name in self.stages)

    def train_command(self, run: Path | None = None) -> str:
        """The commands that train it; for a run, its missing stages."""
        named = f" --run {run.name}" if run else ""
        lacking = [name for name in self.stages if run is None or not RunFolder(run).stage(name).is_complete]
        return " && ".join(f"motionkit train --stage {name}{named}" for name in lacking or self.stages[-1:])


LoaderT = TypeVar("LoaderT", bound=Loader[Any])


def loader_names(group: str) -> tuple[str, ...]:
    """Names of all loaders of an entry point group, sorted; nothing is imported."""
    return tuple(sorted({entry.name for entry in entry_points(group=group)}))


def installed_loaders(group: str, kind: type[LoaderT]) -> dict[str, LoaderT]:
    """All loaders of an entry point group by name, sorted by `order`; plain functions are wrapped in `kind`."""
    found = {entry.name: loader_of(entry, kind) for entry in entry_points(group=group)}
    return dict(sorted(found.items(), key=lambda named: (named[1].order, named[0])))


def loader_of(entry: EntryPoint, kind: type[LoaderT]) -> LoaderT:
    """The loader that an entry point names."""
    named = entry.load()
    return named if isinstance(named, kind) else kind(entry.name, (entry.name,), named)
