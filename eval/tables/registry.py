"""The tables that `motionkit eval` can build: entry points of group `motionkit.tables`, each naming a `Table`.

A package adds its own table the same way; the entry point's name is `PAPER-NUMBER`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING

from eval.clip_fid.score import Protocol
from eval.report.results import Result
from eval.sample_folder import SampleFolder, SampleOptions, read_sample_folder
from eval.text_motion.guo.kind import GuoFiles
from motionkit.core.errors import UsageError
from motionkit.core.progress import OnProgress, ignore, task

if TYPE_CHECKING:
    from motionkit.store.reader import Store


@dataclass(frozen=True)
class TableRequest:
    """What a table is built from: a store, a trained run where there is one, folders of other systems' samples.

    `fps` None means the table's own columns; `features` None means every feature set that is available; `split` names
    the real sequences that are compared with, `where` those of them for which this SQL holds; `guo` names the files of
    a published evaluator; `low_pass_hz`, where given, smooths every set alike before clips are drawn. Tables of whole
    motions follow the protocol called `published`, with the known bugs `compat` switched on, and ask models `draws`
    times for every motion. Tables of completed motion show the trained encoders that `run` holds and those of
    `encoders`, pairs of an encoder's name and a run. `on_progress` is called during long steps.
    """

    store: Path
    results: Path
    run: Path | None = None
    split: str = "test"
    where: str | None = None
    fps: tuple[Fraction, ...] | None = None
    protocol: Protocol = field(default_factory=Protocol)
    samples: Mapping[str, Path] = field(default_factory=dict)
    sample_options: SampleOptions = field(default_factory=SampleOptions)
    features: tuple[str, ...] | None = None
    guo: GuoFiles | None = None
    low_pass_hz: float | None = None
    max_motions: int = 1024
    published: str = "native"
    compat: tuple[str, ...] = ()
    draws: int = 1
    seed: int = 0
    encoders: tuple[tuple[str, Path], ...] = ()
    on_progress: OnProgress = field(default=ignore, compare=False, repr=False)

    def open_store(self) -> "Store":
        """The store, for reading."""
        from motionkit.store.reader import Store

        return Store.open(self.store, on_progress=self.on_progress)

    @property
    def restriction(self) -> str:
        """What `where` adds to a caption that names the split; empty without it."""
        return f" where {self.where}" if self.where else ""

    @cached_property
    def sample_folders(self) -> tuple[SampleFolder, ...]:
        """The motions of every folder of samples, read when they are first asked for; raises `SampleFolderError`."""
        folders = []
        # Guo's evaluators alone read pose vectors and KIT-ML's joints.
        options = replace(self.sample_options, keep_published=self.guo is not None)
        for name, path in self.samples.items():
            with task(self.on_progress, f"reading {name}") as work:
                folders.append(read_sample_folder(name, path, options, work.set))
        return tuple(folders)


@dataclass(frozen=True)
class Table:
    """A table of a paper that can be built here; without `takes_samples` it has no rows of other systems' motions."""

    paper: str
    number: str
    title: str
    build: Callable[[TableRequest], Result]
    takes_samples: bool = True


def installed_tables() -> dict[str, str]:
    """Names of all installed tables (`PAPER-NUMBER`) with the objects that build them."""
    return {entry.name: entry.value for entry in sorted(entry_points(group="motionkit.tables"), key=lambda e: e.name)}


def find_table(paper: str, number: str) -> Table:
    """Load one table. Raises `UsageError` with the ones there are."""
    found = entry_points(group="motionkit.tables", name=f"{paper}-{number}")
    if not found:
        known = ", ".join(installed_tables()) or "none"
        raise UsageError(f"there is no table {number} of {paper!r}; installed tables: {known}")
    table: Table = next(iter(found)).load()
    return table
