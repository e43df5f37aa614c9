"""Ablations: tables whose rows are runs that differ from a recipe in a few settings.

A model registers its own under the entry point group `motionkit.ablations`: PAPER = "module:ATTRIBUTE", an `Ablations`.
That module must import lightly. `motionkit ablate` trains the runs; the tables are elsewhere.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from motionkit.core.errors import UsageError
from motionkit.core.progress import OnProgress, ignore
from motionkit.store.sql import conjunction
from motionkit.training.config import ConfigLike, apply_overrides, flatten, parse_override
from motionkit.training.run import RunFolder
from motionkit.training.stage import Stage, StageContext

GROUP = "motionkit.ablations"


@dataclass(frozen=True)
class Variant:
    """One training run: a name, and the settings that it changes in a recipe, as `--set` takes them.

    `needs` returns settings to apply to a recipe before the change; `may_need` are all that it may return. `conditions`
    are the recipe's own SQL conditions on sequences, by their dotted keys.
    """

    name: str
    change: tuple[str, ...] = ()
    needs: Callable[[Any], tuple[str, ...]] = field(default=lambda recipe: (), compare=False, repr=False)
    may_need: tuple[str, ...] = ()
    conditions: tuple[str, ...] = ()

    @property
    def varied(self) -> frozenset[str]:
        """Keys of all settings in which a table's runs may differ: of `change`, and of `may_need`."""
        return frozenset(parse_override(setting)[0] for setting in (*self.change, *self.may_need))

    def configure(self, recipe: Any, overrides: Sequence[str] = (), where: str | None = None) -> Any:
        """A recipe's configuration with its needs, common overrides, and this variant's change.

        `where` (SQL) restricts the sequences. Raises `UsageError` for an override of a varied setting.
        """
        varied = {parse_override(setting)[0] for setting in self.change}
        for override in overrides:
            if parse_override(override)[0] in varied:
                raise UsageError(f"--set {override}: this is what {self.name!r} varies ({', '.join(self.change)})")
        given = flatten(recipe)
        narrowed = [f"{key}={conjunction(given[key], where)}" for key in self.conditions if where]
        return apply_overrides(recipe, [*self.needs(recipe), *self.change, *narrowed, *overrides])


@dataclass(frozen=True)
class Entry:
    """A row of a table, or a cell if it has a `column`: a variant and its label.

    `reported` is its name in the paper's figures.
    """

    label: str
    variant: Variant
    reported: str = ""
    column: str = ""

    @property
    def name(self) -> str:
        """Row and column."""
        return f"{self.label}; {self.column}" if self.column else self.label


@dataclass(frozen=True)
class Ablation:
    """One table: its rows, and the stages that its columns need."""

    table: str
    title: str
    entries: tuple[Entry, ...]
    stages: tuple[str, ...]

    @property
    def variants(self) -> tuple[Variant, ...]:
        """All trainings of the table, in order of their first row."""
        return tuple(dict.fromkeys(entry.variant for entry in self.entries))


@dataclass(frozen=True)
class Sweep:
    """Common options of an ablation's runs, which are RUNS/PREFIX-VARIANT."""

    store: Path
    runs: Path
    prefix: str
    recipe: str
    seed: int = 0
    overwrite: bool = False
    device: str = "auto"
    on_progress: OnProgress = field(default=ignore, compare=False, repr=False)

    def context(self, run: RunFolder, seed: int, *, overwrite: bool) -> StageContext:
        """A context for one run."""
        return StageContext(
            self.store,
            run,
            self.recipe,
            seed=seed,
            resume=not overwrite,
            overwrite=overwrite,
            device=self.device,
            on_progress=self.on_progress,
        )


Prepare = Callable[[Sweep, RunFolder, Any], None]


def nothing_to_prepare(sweep: Sweep, run: RunFolder, config: Any) -> None:
    """For models whose variants share nothing."""


@dataclass(frozen=True)
class Ablations:
    """All ablations of one paper's model, which is installed under the name `paper` too.

    `recipes` are those that can be varied; `stages` are the stages to train, of which `--stage` can select the first
    alone. `prepare` gives a run what the variants share (a codebook), before its first stage is trained. `is_default`
    marks the default of `motionkit ablate`.
    """

    paper: str
    tables: Mapping[str, Ablation]
    recipes: Mapping[str, Callable[[], ConfigLike]]
    stages: Mapping[str, Stage[Any]]
    prepare: Prepare = nothing_to_prepare
    is_default: bool = False

    def find(self, table: str) -> Ablation:
        """The ablation of a table; raises `UsageError` that lists the known ones."""
        if table not in self.tables:
            known = ", ".join(f"{name} ({ablation.title})" for name, ablation in self.tables.items())
            raise UsageError(f"there is no ablation {table!r} of {self.paper!r}; there are: {known}, or all")
        return self.tables[table]

    def recipe(self, name: str) -> Any:
        """A recipe's configuration; raises `UsageError` that lists the known ones."""
        if name not in self.recipes:
            raise UsageError(f"there is no recipe {name!r}: {', '.join(self.recipes)}")
        return self.recipes[name]()

    def command_for(self, table: str, prefix: str, variant: Variant) -> str:
        """The command that trains one variant of a table."""
        paper = "" if self.is_default else f" --paper {self.paper}"
        return f"motionkit ablate {table}{paper} --run {prefix} --only {variant.name}"


def papers_with_ablations() -> tuple[str, ...]:
    """The papers of all installed ablations, sorted."""
    return tuple(sorted({entry.name for entry in entry_points(group=GROUP)}))


def find_ablations(paper: str | None = None) -> Ablations:
    """The ablations of a paper's model, or the default ones; raises `UsageError` that lists the known papers."""
    found: dict[str, Ablations] = {
        entry.name: entry.load() for entry in entry_points(group=GROUP) if paper is None or entry.name == paper
    }
    if paper is None:
        found = {name: ablations for name, ablations in found.items() if ablations.is_default}
    if not found:
        which = "there are no ablations of " + repr(paper) if paper else "name a paper with --paper"
        raise UsageError(f"{which}; of: {', '.join(papers_with_ablations()) or 'none'}")
    return next(iter(found.values()))


def run_name(prefix: str, variant: Variant, seed: int) -> str:
    """The run of one variant: PREFIX-VARIANT, and -seedN after it for any seed but 0."""
    return f"{prefix}-{variant.name}" + (f"-seed{seed}" if seed else "")


def train_variant(
    ablations: Ablations, sweep: Sweep, variant: Variant, config: Any, stages: Sequence[str]
) -> dict[str, Any]:
    """Train a variant's missing stages; returns its run's name, each stage's summary and the CPU seconds.

    Complete stages are kept. Raises `RunError` if they were trained with other settings, `BusyError` while another
    process trains one of them, and what training raises.
    """
    run = RunFolder(sweep.runs / run_name(sweep.prefix, variant, sweep.seed))
    context = sweep.context(run, sweep.seed, overwrite=sweep.overwrite)
    started = time.process_time()
    summaries = {}
    with ExitStack() as locks:
        for name in stages:
            locks.enter_context(run.stage(name).locked())
        ablations.prepare(sweep, run, config)
        for name in stages:
            folder = run.stage(name)
            if folder.is_complete and not sweep.overwrite:
                check_unchanged(context, ablations.stages[name], config)
            else:
                ablations.stages[name].train(context, config)
            summaries[name] = folder.read_summary()
    return {
        "run": run.path.name,
        "variant": variant.name,
        "stages": summaries,
        "cpu_seconds": round(time.process_time() - started, 1),
    }


def check_unchanged(context: StageContext, stage: Stage[Any], config: Any) -> None:
    """Raise `RunError` if a complete stage was trained with other settings than now."""
    from motionkit.store.manifest import read_manifest  # the list of ablations is read for --help

    stage.check_kept(context, config, read_manifest(context.store).fingerprint)
