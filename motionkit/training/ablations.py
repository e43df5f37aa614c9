"""Ablations: tables whose rows are runs that differ from a recipe in a few settings.

A package lists its own in `ABLATIONS` (`motionkit.core.plugins`) by the paper, from a module that imports lightly.
`motionkit ablate` trains the runs; the tables are listed in `TABLES`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from motionkit.core.errors import UsageError
from motionkit.training.config import ConfigLike, apply_overrides, flatten, parse_override
from motionkit.training.run import RunFolder, Stage, StageContext


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
        from motionkit.store.sql import conjunction  # deferred: tables are listed without a store

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
class Ablations:
    """All ablations of one paper's model, which is installed under the name `paper` too.

    `recipes` are those that can be varied; `stages` are the stages to train, of which `--stage` can select the first
    alone. `prepare`, called before a run's first stage with the context of the common run, the variant's run and its
    configuration, gives that run what all variants share (a codebook), trained in the common run if it is missing.
    `is_default` marks the default of `motionkit ablate`.
    """

    paper: str
    tables: Mapping[str, Ablation]
    recipes: Mapping[str, Callable[[], ConfigLike]]
    stages: Mapping[str, Stage[Any]]
    prepare: Callable[[StageContext, RunFolder, Any], None] = lambda common, run, config: None
    is_default: bool = False
