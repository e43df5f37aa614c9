"""The tables of `motionkit eval`: a package lists its own in `TABLES`, by PAPER-NUMBER (`motionkit.core.plugins`)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eval.clip_fid.clips import Protocol
from eval.report.results import Result, provenance
from eval.sample_folder import SampleFolder, SampleOptions, read_sample_folder
from eval.sets.real import of_split_and
from eval.text_motion.guo.kind import GuoFiles
from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.core.progress import OnProgress, ignore, task
from motionkit.training.run import Loader

if TYPE_CHECKING:
    from motionkit.store.reader import Store


@dataclass(frozen=True)
class RealMotions:
    """The reference: the sequences of a store's split ("all": any) for which `where` (SQL) holds."""

    store: Path
    split: str = "test"
    where: str | None = None

    @property
    def condition(self) -> str | None:
        """The SQL condition for all of it; None for the whole store."""
        return of_split_and(self.split, self.where)

    @property
    def named(self) -> str:
        """Its name in captions: the split, and the condition if there is one."""
        return f"split {self.split!r}" + (f" where {self.where}" if self.where else "")


@dataclass(frozen=True)
class Evaluated:
    """What is evaluated: the models and encoders of a run, folders of other systems' samples, encoders of other runs.

    A model generates at most `max_motions` motions, `draws` times. `encoders` are pairs of an encoder's name and a run.
    """

    run: Path | None = None
    samples: Mapping[str, Path] = field(default_factory=dict)
    sample_options: SampleOptions = field(default_factory=SampleOptions)
    encoders: tuple[tuple[str, Path], ...] = ()
    max_motions: int = 1024
    draws: int = 1


@dataclass(frozen=True)
class Evaluators:
    """The evaluators (feature sets, recognisers) by name, None for all; files of published ones.

    `motion_clip` is the folder of MARDM's MotionCLIP.
    """

    names: tuple[str, ...] | None = None
    guo: GuoFiles | None = None
    motion_clip: Path | None = None


@dataclass(frozen=True)
class ClipFidSettings:
    """Settings of clip-FID; `low_pass_hz`, if given, low-passes every set before clips are drawn."""

    protocol: Protocol = field(default_factory=Protocol)
    low_pass_hz: float | None = None


@dataclass(frozen=True)
class PublishedProtocol:
    """The protocol of tables of whole motions, by name, and which of its known bugs are switched on."""

    name: str = "native"
    compat: tuple[str, ...] = ()


@dataclass(frozen=True)
class TableRequest:
    """Inputs of a table, and the folder of its results.

    `fps` None means the table's own columns. `on_progress` is called during long steps.
    """

    real: RealMotions
    results: Path
    evaluated: Evaluated = field(default_factory=Evaluated)
    evaluators: Evaluators = field(default_factory=Evaluators)
    clip_fid: ClipFidSettings = field(default_factory=ClipFidSettings)
    published: PublishedProtocol = field(default_factory=PublishedProtocol)
    fps: tuple[Fraction, ...] | None = None
    seed: int = 0
    on_progress: OnProgress = field(default=ignore, compare=False, repr=False)

    def open_store(self) -> "Store":
        """The store, for reading."""
        from motionkit.store.reader import Store

        return Store.open(self.real.store, on_progress=self.on_progress)

    def provenance(self, store: "Store", *others: Path, **more: Any) -> dict[str, Any]:
        """Provenance of a result: the store, the weights of evaluated and other runs, seed, environment, and `more`."""
        asked = (*([] if self.evaluated.run is None else [self.evaluated.run]), *others)
        runs = [run for run in (*asked, *(run for _, run in self.evaluated.encoders)) if run.is_dir()]
        return {**provenance(store.path, runs), **more, "seed": self.seed}

    @cached_property
    def sample_folders(self) -> tuple[SampleFolder, ...]:
        """The motions of every folder of samples, read when first accessed; raises `SampleFolderError`."""
        folders = []
        # Only published evaluators read pose vectors and KIT-ML's joints.
        keep = self.evaluators.guo is not None or self.evaluators.motion_clip is not None
        options = replace(self.evaluated.sample_options, keep_published=keep)
        for name, path in self.evaluated.samples.items():
            with task(self.on_progress, f"reading {name}") as work:
                folders.append(read_sample_folder(name, path, options, work.set))
        return tuple(folders)


@dataclass(frozen=True)
class Table:
    """A table of a paper; without `takes_samples` it has no rows of other systems' motions.

    `shown` gives the loaders of its rows, `reads` names the evaluators among a run's stages that it reads, and
    `settings` are its systems' training settings, as for `--set`: `motionkit train --for` uses these to find what is
    missing (eval/tables/systems.py).
    """

    paper: str
    number: str
    title: str
    build: Callable[[TableRequest], Result]
    takes_samples: bool = True
    shown: Callable[[], Mapping[str, Loader[Any]]] = dict
    reads: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()

    @property
    def is_default(self) -> bool:
        """Whether it is of the default paper."""
        return self.paper == "nerm"


def installed_tables() -> tuple[str, ...]:
    """Names of all installed tables (`PAPER-NUMBER`)."""
    return plugins.names("TABLES")


def find_table(paper: str, number: str) -> Table:
    """Load one table. Raises `UsageError` that lists the tables."""
    if f"{paper}-{number}" not in (known := installed_tables()):
        raise UsageError(f"there is no table {number} of {paper!r}; installed tables: {', '.join(known) or 'none'}")
    table: Table = plugins.load("TABLES", f"{paper}-{number}")
    return table
