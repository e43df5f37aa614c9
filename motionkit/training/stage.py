"""Trainable stages; a package lists its own in `STAGES` (`motionkit.core.plugins`)."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic

from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.core.progress import OnProgress, ignore
from motionkit.training.config import ConfigLike, ConfigT, Precision, apply_overrides, flatten, parse_override, to_plain
from motionkit.training.run import (
    STAGE_NAME,
    OnMetrics,
    RunFolder,
    StageFolder,
    begin_stage,
    check_resumable,
)

if TYPE_CHECKING:
    from motionkit.store.reader import Store
    from motionkit.training.devices import Ranks
    from motionkit.training.loop import Trainable


@dataclass(frozen=True)
class StageContext:
    """The context of a stage's training: store, run, seed, device.

    `device` is "auto" or a torch device's name; `shared`: whether all ranks of torchrun train this stage;
    `budget_seconds` is the processor time for its steps, which replaces their number (None: no budget). `on_progress`
    is called during training and while caches are built, `on_metrics` with each stage's logged metrics.
    """

    store: Path
    run: RunFolder
    recipe: str
    seed: int = 0
    resume: bool = False
    overwrite: bool = False
    device: str = "auto"
    shared: bool = False
    budget_seconds: float | None = None
    on_progress: OnProgress = field(default=ignore, compare=False, repr=False)
    on_metrics: OnMetrics = field(default=lambda stage, values: None, compare=False, repr=False)

    def open_store(self) -> "Store":
        """The store, for reading."""
        from motionkit.store.reader import Store

        return Store.open(self.store, on_progress=self.on_progress)

    @property
    def ranks(self) -> "Ranks":
        """The ranks that train this stage together."""
        from motionkit.training.devices import ALONE, present_ranks

        return present_ranks() if self.shared else ALONE

    def begin(
        self, stage: str, config: ConfigLike, *, store_fingerprint: str, builds_on: Sequence[str] = ()
    ) -> StageFolder:
        """Open the stage's folder on the first rank, new or to resume; errors as in `begin_stage`.

        `builds_on` names the stages of this run whose model.safetensors it reads; resuming requires the same ones.
        """
        folder = StageFolder(self.run.stage(stage).path, partial(self.on_metrics, stage))
        inputs = self.inputs(config, store_fingerprint, builds_on)
        self.ranks.on_first(partial(begin_stage, folder, inputs, resume=self.resume, overwrite=self.overwrite))
        return folder

    def inputs(self, config: ConfigLike, store_fingerprint: str, builds_on: Sequence[str]) -> dict[str, Any]:
        """The inputs of a stage with these settings, as its config.json has them."""
        return {
            "config": to_plain(config),
            "recipe": self.recipe,
            "seed": self.seed,
            "store": str(self.store),
            "store_fingerprint": store_fingerprint,
            "builds_on": self.run.fingerprints(builds_on),
            "budget_seconds": self.budget_seconds,
        }

    def train(self, training: "Trainable", folder: StageFolder, precision: Precision) -> dict[str, float]:
        """Run a training's steps, as many as the budget allows if there is one.

        Returns the figures of `train_loop`; errors as there and in `plan_steps`.
        """
        from motionkit.training.devices import float32_products, resolve_device
        from motionkit.training.loop import plan_steps, seconds_spent, train_loop

        with float32_products(precision):
            if self.budget_seconds is not None:
                if self.ranks.size > 1:
                    raise UsageError("--budget is for one process: a rank does not know what the others have spent")
                clock = seconds_spent(resolve_device(self.device))
                plan_steps(training, folder, self.budget_seconds, self.seed, clock)
            return train_loop(training, folder, seed=self.seed, ranks=self.ranks, on_progress=self.on_progress)


@dataclass(frozen=True)
class Stage(Generic[ConfigT]):
    """A trainable stage: `train(context, config)` writes RUN/NAME/ and ends with `StageFolder.finish`.

    `builds_on(config)` names the stages whose results it reads; `train` passes the same to `StageContext.begin`.
    `check(context, config)` raises errors that can be found before any training, without other stages' results.
    `recipes` maps names to functions that make a configuration. Stages of one model may share a configuration whose
    parts are named after the stages: a change of another stage's part doesn't prevent `--resume`. Under torchrun every
    rank calls the `train` of a `shared` stage (`motionkit.training.devices`); others are trained by the first rank
    alone. `share` is its share of its system's time budget, relative to the system's other stages (`StagePlan`).
    """

    name: str
    description: str
    recipes: Mapping[str, Callable[[], ConfigT]]
    train: Callable[[StageContext, ConfigT], None]
    check: Callable[[StageContext, ConfigT], None] = lambda context, config: None
    shared: bool = False
    share: float = 1.0
    builds_on: Callable[[ConfigT], tuple[str, ...]] = lambda config: ()

    def __post_init__(self) -> None:
        if not re.fullmatch(STAGE_NAME, self.name):
            raise UsageError(f"a stage's name is of letters, digits, '_' and '-', no '-' first, not {self.name!r}")

    def check_kept(self, context: StageContext, config: ConfigT, store_fingerprint: str) -> None:
        """Raise `RunError` if this stage was begun with other inputs than the same command would use now."""
        inputs = context.inputs(config, store_fingerprint, self.builds_on(config))
        check_resumable(context.run.stage(self.name), inputs)

    def configured(self, recipe: str, overrides: Sequence[str]) -> ConfigT:
        """The configuration of a recipe, with those overrides (`a.b=c`) whose setting it has; raises `UsageError`."""
        config = self.recipe(recipe)
        known = flatten(config)
        return apply_overrides(config, [each for each in overrides if parse_override(each)[0] in known])

    def recipe(self, name: str) -> ConfigT:
        """The configuration of a recipe; raises `UsageError` that lists the known ones."""
        if name not in self.recipes:
            raise UsageError(f"stage {self.name!r} has no recipe {name!r}; it has: {', '.join(self.recipes)}")
        return self.recipes[name]()


@dataclass(frozen=True)
class StagePlan:
    """Stages to train for one purpose, in order: what `--stage` selects, or a function that a package lists in `PLANS`.

    Such a function is called with the value of `--for`, `--paper`, the `StageContext` and the overrides.
    `shares` are the shares of a system's time budget by stage; they sum to 1 for each system, and evaluators have none.
    `settings` are overrides that apply before the user's; `next_command` uses what was trained.
    """

    stages: tuple[Stage[Any], ...]
    shares: Mapping[str, float]
    settings: tuple[str, ...] = ()
    next_command: str = ""


def recorded_settings(run: RunFolder, stage: str) -> dict[str, Any]:
    """The settings of a stage of a run, as its config.json holds them."""
    recorded: dict[str, Any] = run.stage(stage).read_config().get("config", {})
    return recorded


def choose_stages(name: str) -> tuple[Stage[Any], ...]:
    """The stages that `--stage NAME` selects; raises `UsageError` that lists the known ones."""
    known = plugins.names("STAGES")
    if name not in (*known, "all"):
        raise UsageError(f"no stage is called {name!r}; there are: {', '.join([*known, 'all'])}")
    return tuple(plugins.load("STAGES", each) for each in (plugins.names("ALL") if name == "all" else (name,)))
