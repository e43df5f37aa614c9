"""What packages bring to be loaded from runs: entry points that name a loader, with what tables call it.

The entry point's module must import lightly (no torch at module level), for titles are listed without loading anything.
A plain function from a run folder does as well: its title is then the entry point's name, and so is the stage that must
be trained.
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
    """Something that is loaded from the stages of a run.

    `title` is its name in tables and messages; `stages` are those that it is made of; where there are several loaders,
    the one of the lowest `order` comes first.
    """

    title: str
    stages: tuple[str, ...]
    load: Callable[[Path], T]
    order: int = 100

    def begun_in(self, run: Path) -> bool:
        """Whether a run holds a trained stage of it, though perhaps not all of them."""
        stages = [RunFolder(run).stage(name) for name in self.stages]
        return any(stage.is_complete or stage.model_path.is_file() for stage in stages)

    def complete_in(self, run: Path) -> bool:
        """Whether all its stages are trained in a run."""
        return all(RunFolder(run).stage(name).is_complete for name in self.stages)

    def train_command(self, run: Path | None = None) -> str:
        """The commands that train it, of a run those of the stages that it lacks."""
        named = f" --run {run.name}" if run else ""
        lacking = [name for name in self.stages if run is None or not RunFolder(run).stage(name).is_complete]
        return " && ".join(f"motionkit train --stage {name}{named}" for name in lacking or self.stages[-1:])


LoaderT = TypeVar("LoaderT", bound=Loader[Any])


def loader_names(group: str) -> tuple[str, ...]:
    """Names of all loaders of an entry point group, sorted; nothing is imported."""
    return tuple(sorted({entry.name for entry in entry_points(group=group)}))


def installed_loaders(group: str, kind: type[LoaderT]) -> dict[str, LoaderT]:
    """All loaders of an entry point group by name, sorted by their order; `kind` is what plain functions become."""
    found = {entry.name: loader_of(entry, kind) for entry in entry_points(group=group)}
    return dict(sorted(found.items(), key=lambda named: (named[1].order, named[0])))


def loader_of(entry: EntryPoint, kind: type[LoaderT]) -> LoaderT:
    """The loader that an entry point names."""
    named = entry.load()
    return named if isinstance(named, kind) else kind(entry.name, (entry.name,), named)
