"""Ablations: tables whose rows are runs that differ from a recipe in a few settings; `motionkit ablate` trains them.

A package lists its own in `ABLATIONS` (`motionkit.core.plugins`) by the paper, from a module that imports lightly.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.training.config import apply_overrides
from motionkit.training.run import RunFolder, Stage, StageContext


@dataclass(frozen=True)
class Variant:
    """One training run, which is a row of tables, or a cell if it has a `column`.

    Runs are called by `name`; `change` are the settings that differ from a recipe's, as `--set` takes them. `needs`
    returns settings to apply to a recipe before. Rows of the same run differ in their `label` and `column` alone, and
    are equal.
    """

    name: str
    change: tuple[str, ...] = ()
    label: str = field(default="", compare=False)
    column: str = field(default="", compare=False)
    needs: Callable[[Any], tuple[str, ...]] = field(default=lambda recipe: (), compare=False, repr=False)

    def configure(self, recipe: Any, overrides: Sequence[str] = ()) -> Any:
        """A recipe's configuration with its needs, common overrides, and this variant's change, which wins."""
        return apply_overrides(recipe, [*self.needs(recipe), *overrides, *self.change])


@dataclass(frozen=True)
class Ablation:
    """One table: its rows, and the stages that its columns need."""

    table: str
    title: str
    variants: tuple[Variant, ...]
    stages: tuple[str, ...]


@dataclass(frozen=True)
class Ablations:
    """All ablations of one paper's model, which is installed under the name `paper` too.

    `prepare`, called before a run's first stage with the context of the common run, the variant's run and its
    configuration, gives that run what all variants share (a codebook), trained in the common run if it is missing.
    `is_default` marks the default of `motionkit ablate`.
    """

    paper: str
    tables: Mapping[str, Ablation]
    stages: Mapping[str, Stage[Any]]
    prepare: Callable[[StageContext, RunFolder, Any], None] = lambda common, run, config: None
    is_default: bool = False

    def command(self, table: str, prefix: Path) -> str:
        """The command that trains a table's variants as runs PREFIX-VARIANT."""
        return f"motionkit ablate {table}{'' if self.is_default else f' --paper {self.paper}'} --run {prefix.name}"

    def trained_runs(self, table: str, prefix: Path | None, stage: str) -> dict[Variant, dict[int, RunFolder]]:
        """The runs of a table's variants by their seeds, in which a stage is complete.

        Raises `UsageError` without the runs' prefix, or if none is trained.
        """
        if prefix is None:
            raise UsageError("an ablation table needs the name of its runs: --run NAME for runs/NAME-VARIANT")
        runs = {}
        for variant in self.tables[table].variants:
            named = {seed: run_of(prefix, variant, seed) for seed in range(100)}
            runs[variant] = {seed: run for seed, run in named.items() if run.stage(stage).is_complete}
        if not any(runs.values()):
            command = self.command(table, prefix)
            raise UsageError(f"no run of this table is trained in {str(prefix.parent)!r} ({command})")
        return runs


def find_ablations(paper: str | None = None) -> Ablations:
    """The ablations of a paper's model, or the default ones; raises `UsageError` that lists the known papers."""
    known: dict[str, Ablations] = plugins.load_all("ABLATIONS")
    for name, ablations in known.items():
        if name == paper or (paper is None and ablations.is_default):
            return ablations
    raise UsageError(f"there are no ablations of {paper!r}; --paper: {', '.join(known) or 'none'}")


def run_of(prefix: Path, variant: Variant, seed: int) -> RunFolder:
    """The run of one variant: PREFIX-VARIANT, and -seedN after it for any seed but 0."""
    return RunFolder(prefix.with_name(f"{prefix.name}-{variant.name}" + (f"-seed{seed}" if seed else "")))
