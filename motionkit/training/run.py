"""Run folders and the stages that are trained into them.

RUN/STAGE/ has config.json, metrics.jsonl, checkpoint.safetensors, the stage's results, summary.json. `config.json`
records settings and inputs (recipe values, seed, store fingerprint, versions); `summary.json` marks the stage as
complete. SHA256SUMS is then the record of these files, and each is compared with it when it is read. A package lists
its stages in `STAGES` (`motionkit.core.plugins`).
"""

import importlib.metadata
import json
import platform
import re
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

from motionkit.core import plugins
from motionkit.core.errors import DamagedFileError, MotionkitError, UsageError, shown
from motionkit.core.files import (
    LOCK,
    RECORD,
    default_path,
    is_temporary,
    locked_folder,
    naming,
    read_json,
    read_record,
    remove_entry,
    sha256_of,
    write_json,
    write_record,
    write_whole,
)
from motionkit.core.progress import OnProgress, ignore, warn
from motionkit.training.config import ConfigLike, ConfigT, apply_overrides, flatten, leaves, parse_override, to_plain

if TYPE_CHECKING:
    from motionkit.store.reader import Store
    from motionkit.training.networks import Ranks


DEFAULT_RUN = "nano"
# A pattern. Without a hyphen first, as options have.
STAGE_NAME = r"\w[\w-]*"
SHOWN_LETTERS = 24
RECORDED_PACKAGES = ("motionkit", "torch", "numpy", "scipy", "safetensors")


# Called with a stage's name and logged metrics.
OnMetrics = Callable[[str, Mapping[str, float]], None]
HINT = "restore it from a copy, or train the stage again with --overwrite"


T = TypeVar("T")


class RunError(MotionkitError):
    """A run folder that lacks a required result, or has an unsuitable one."""


def versions() -> dict[str, str]:
    """Python, platform and the packages that affect a run's numbers."""
    packages = {name: importlib.metadata.version(name) for name in RECORDED_PACKAGES}
    return {"python": platform.python_version(), "platform": platform.platform(), **packages}


class StageFolder:
    """A stage's folder inside a run; owns the names of its files. `on_metrics` is called with logged metrics."""

    def __init__(self, path: Path, on_metrics: Callable[[Mapping[str, float]], None] = lambda values: None) -> None:
        self.path = path
        self.on_metrics = on_metrics
        self.config_path = path / "config.json"  # settings and inputs
        self.metrics_path = path / "metrics.jsonl"  # one JSON object per logged step
        self.checkpoint_path = path / "checkpoint.safetensors"  # everything needed to resume
        self.model_path = path / "model.safetensors"  # the trained model
        self.summary_path = path / "summary.json"  # final metrics; if it exists, the stage is complete
        self.budget_path = path / "budget.json"  # number of steps of a processor time budget, if one was given

    @property
    def result_paths(self) -> tuple[Path, ...]:
        """All files of a complete stage except its checkpoint; the last one marks it as complete."""
        return self.config_path, self.metrics_path, self.model_path, self.path / RECORD, self.summary_path

    @property
    def is_complete(self) -> bool:
        """Whether the stage was trained to its end."""
        return self.summary_path.is_file()

    def read_config(self) -> dict[str, Any]:
        """Read config.json; raises `RunError` if the stage is not trained, `DamagedFileError`."""
        return self._read(self.config_path)

    def read_summary(self) -> dict[str, Any]:
        """The final metrics; raises `RunError` if the stage is not complete, `DamagedFileError`."""
        return self._read(self.summary_path)

    def check(self) -> None:
        """Raise `RunError` if the stage is not complete, `DamagedFileError` for a damaged file."""
        self.read_config()
        self.read_summary()
        if not self.model_path.is_file():
            raise RunError(f"{self.path} is called complete, but has no {self.model_path.name}")
        check_recorded(self.model_path)

    def effort(self) -> dict[str, str]:
        """Steps, parameters and processor time from the summary of a complete stage, as text."""
        summary = self.read_summary() if self.is_complete else {}
        formats = {
            "steps": ("{:,.0f}", summary.get("steps", summary.get("step"))),
            "parameters": ("{:,.0f}", summary.get("parameters")),
            "processor time": ("{:,.0f} s", summary.get("cpu_seconds")),
        }
        return {name: form.format(value) for name, (form, value) in formats.items() if value is not None}

    def read_budget(self) -> dict[str, Any]:
        """Read budget.json; raises `RunError` if there is none, `DamagedFileError`."""
        return self._read(self.budget_path)

    def append_metrics(self, values: Mapping[str, float]) -> None:
        """Add a line to metrics.jsonl."""
        with naming(self.metrics_path), self.metrics_path.open("a", encoding="utf-8") as log:
            log.write(json.dumps(dict(values)) + "\n")
        self.on_metrics(values)

    def read_metrics(self) -> list[dict[str, float]]:
        """All complete lines of metrics.jsonl, oldest first; empty if nothing was logged.

        The log of a complete stage is compared with its record; of another, a partial last line is left out.
        """
        if not self.metrics_path.is_file():
            return []
        if self.is_complete:
            check_recorded(self.metrics_path)
        metrics = []
        for line in self.metrics_path.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError):
                metrics.append(json.loads(line))
        return metrics

    def keep_metrics(self, step: int) -> None:
        """Drop what was logged after a step, as a checkpoint of that step is resumed."""
        kept = [values for values in self.read_metrics() if values["step"] <= step]
        if self.metrics_path.is_file():
            write_whole(self.metrics_path, "".join(json.dumps(values) + "\n" for values in kept))

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Write the final metrics, which marks the stage as complete, and record the files' sha256."""
        budget = self.read_budget() if self.budget_path.is_file() else {}
        write_json(self.summary_path, {**summary, **budget})
        paths = (self.config_path, self.metrics_path, self.model_path, self.summary_path)
        write_record(self.path, [path.name for path in paths if path.is_file()])

    def locked(self) -> AbstractContextManager[None]:
        """Hold the stage's lock during a training; raises `BusyError` while another process holds it."""
        busy = f"another process is training {self.path}: wait until it has ended, or name another --run"
        return locked_folder(self.path, busy=busy)

    def _read(self, path: Path) -> dict[str, Any]:
        if not path.is_file():
            raise RunError(
                f"{path} does not exist: stage {self.path.name!r} of run {str(self.path.parent)!r} is not trained "
                f"(motionkit train --stage {self.path.name} --run {self.path.parent.name})"
            )
        if self.is_complete:
            check_recorded(path)
        return read_json(path, HINT)


def check_recorded(path: Path) -> None:
    """Raise `DamagedFileError` for a file that is not what its folder's record of sha256 says, if it has one."""
    if (path.parent / RECORD).is_file():
        recorded = read_record(path.parent, HINT).get(path.name)
        if recorded is not None and recorded != sha256_of(path):
            raise DamagedFileError(path, f"its content is not what {RECORD} says", HINT)


@dataclass(frozen=True)
class RunFolder:
    """A run: one subfolder per trained stage."""

    path: Path

    def stage(self, name: str) -> StageFolder:
        """The folder of a stage, which need not exist yet."""
        return StageFolder(self.path / name)

    def fingerprints(self, stages: Iterable[str] | None = None) -> dict[str, str]:
        """Hexadecimal sha256 of the models of those stages that have one; of all stages by default."""
        if stages is None:
            stages = sorted(path.parent.name for path in self.path.glob("*/model.safetensors"))
        paths = {name: self.stage(name).model_path for name in stages}
        return {name: sha256_of(path) for name, path in paths.items() if path.is_file()}


def find_run(name: str | Path | None, runs: Path | None = None) -> Path:
    """The folder of a run: of this name in the folder of all runs, or a folder itself, or one that a package ships.

    Without a name it is `nano`, or where there is none the first that is shipped, with a warning. The folder of an
    unknown name does not exist. A package lists the run folders that it ships in `RUNS` (`motionkit.core.plugins`).
    """
    folder, shipped = runs or default_path("runs"), plugins.names("RUNS")
    if name is None and shipped and not (folder / DEFAULT_RUN).is_dir():
        warn(f"there is no run {folder / DEFAULT_RUN}: using {shipped[0]}, which comes with motionkit")
        name = shipped[0]
    place = folder / (name or DEFAULT_RUN)
    if name is None or place.is_dir():
        return place
    if str(name) in shipped and not Path(name).is_dir():
        return Path(plugins.load("RUNS", str(name)))
    return Path(name) if Path(name).is_dir() else place


# Tasks of motion encoders: frames between given ones; gaps and ends; reconstruction of windows.
Task = Literal["interpolation", "inbetweening", "extrapolation", "reconstruction"]
COMPLETION: tuple[Task, ...] = ("interpolation", "inbetweening", "extrapolation")


@dataclass(frozen=True)
class Loader(Generic[T]):
    """A model or a motion encoder of a package: what loads it from the stages of a run.

    `title` is its name in tables and messages; `stages` are those it needs. Of a model, `fixed_fps_setting` is the
    setting that trains it at a single framerate, for comparison in some tables (empty if it has none). Tables use the
    encoders of their `tasks`; the `preferred` one is the default for completing clips.
    """

    title: str
    stages: tuple[str, ...]
    load: Callable[[Path], T]
    fixed_fps_setting: str = ""
    tasks: tuple[Task, ...] = COMPLETION
    preferred: bool = False

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


def installed_loaders(kind: Literal["MODELS", "ENCODERS"]) -> dict[str, Loader[Any]]:
    """All installed models or encoders by name."""
    return {name: loader_named(kind, name) for name in plugins.names(kind)}


def loader_named(kind: Literal["MODELS", "ENCODERS"], name: str) -> Loader[Any]:
    """The loader of an installed model or encoder; a plain function gets its name as title and stage.

    Raises `UsageError` that lists the installed ones.
    """
    try:
        found = plugins.load(kind, name)
    except KeyError:
        what, known = "model" if kind == "MODELS" else "trained encoder", ", ".join(plugins.names(kind)) or "none"
        raise UsageError(f"no {what} is called {name!r}; installed: {known}") from None
    return found if isinstance(found, Loader) else Loader(name, (name,), found)


def begin_stage(folder: StageFolder, inputs: Mapping[str, Any], *, resume: bool, overwrite: bool) -> None:
    """Create a stage's folder and write its config.json, or check that an existing one can be resumed.

    `inputs` are those of `StageContext.inputs`. Raises `UsageError` if the folder exists and neither `resume` nor
    `overwrite` is set, and `RunError` if the stage was begun from other inputs.
    """
    if resume:
        check_resumable(folder, inputs)
        if folder.config_path.is_file():
            return
    elif _holds_something(folder):
        if not overwrite:
            raise UsageError(
                f"{folder.path} exists: --resume continues it, --overwrite starts again, --run NAME keeps both"
            )
        clear_stage(folder)
    folder.path.mkdir(parents=True, exist_ok=True)
    code = {"versions": versions(), "commit": commit()}
    write_json(folder.config_path, {"stage": folder.path.name, **inputs, **code})


def check_resumable(folder: StageFolder, inputs: Mapping[str, Any]) -> None:
    """Raise `RunError` if a stage was begun from other inputs, or has files but no config.json."""
    if folder.config_path.is_file():
        check_same(folder, inputs)
    elif _holds_something(folder):
        raise RunError(
            f"{folder.path} cannot be resumed, for it has no {folder.config_path.name}: train the stage again with "
            f"--overwrite"
        )


def _holds_something(folder: StageFolder) -> bool:
    """Whether a stage was begun there; not if it was killed before writing its config.json."""
    return any(entry.name != LOCK and not is_temporary(entry) for entry in folder.path.glob("*"))


def clear_stage(folder: StageFolder) -> None:
    """Delete a stage's files except its lock and config.json, which the next training replaces.

    In this order a killed process leaves no folder that counts as complete, or that another training could resume.
    """
    first = [folder.summary_path, folder.path / RECORD, folder.checkpoint_path]
    for path in [*first, *sorted(folder.path.iterdir())]:
        if path not in (folder.config_path, folder.path / LOCK):
            remove_entry(path)


def check_same(folder: StageFolder, inputs: Mapping[str, Any]) -> None:
    """Raise `RunError` if a stage was begun from other values of these inputs.

    Settings of the recipe's other stages don't count, nor its name and the store's place; "auto" matches the recorded
    choice.
    """
    begun, stage, run = folder.read_config(), folder.path.name, folder.path.parent.name
    compared = [name for name in inputs if name not in ("recipe", "store")]
    before, now = (leaves({name: each.get(name) for name in compared}) for each in (begun, inputs))
    changed = [
        f"{key.removeprefix('config.')} {shown(before.get(key), SHOWN_LETTERS)} → {shown(now.get(key), SHOWN_LETTERS)}"
        for key in {**before, **now}
        if before.get(key) != now.get(key) and now.get(key) != "auto"
        # The model of an earlier stage may have been deleted since.
        if key in now or not key.startswith("builds_on.")
        if not key.startswith("config.") or concerns(stage, key.removeprefix("config."), inputs["config"])
    ]
    if changed:
        raise RunError(
            f"{folder.path} was begun from other inputs ({', '.join(changed)}): use the same ones, train it again "
            f"(motionkit train --stage {stage} --run {run} --overwrite), or use another --run"
        )


def concerns(stage: str, key: str, config: Mapping[str, Any]) -> bool:
    """Whether a dotted setting of a plain configuration affects a stage: parts named after other stages don't."""
    parts = {name for name, value in config.items() if isinstance(value, dict)}
    return stage not in parts or key.partition(".")[0] not in parts - {stage}


def commit(code: Path = Path(__file__)) -> str | None:
    """The commit of this code, if it runs from its own git checkout.

    An installation inside another project's checkout does not count.
    """
    code = code.resolve()
    git = partial(subprocess.check_output, cwd=code.parent, stderr=subprocess.DEVNULL, text=True, timeout=10)
    try:
        git(("git", "ls-files", "--error-unmatch", code.name))  # fails for untracked files
        return str(git(("git", "rev-parse", "HEAD"))).strip()
    except (OSError, subprocess.SubprocessError):
        return None


@dataclass(frozen=True)
class Began:
    """When a stage began: this process' CPU time and the wall clock, in seconds."""

    cpu_seconds: float = field(default_factory=time.process_time)
    wall_seconds: float = field(default_factory=time.perf_counter)


@dataclass(frozen=True)
class StageContext:
    """The context of a stage's training: store, run, seed, device.

    `device` is "auto" or a torch device's name; `shared`: whether all ranks of torchrun train this stage;
    `budget_seconds` is its processor time since it `began`, which sets the number of steps (None: no budget).
    `on_progress` is called during training and while caches are built, `on_metrics` with each stage's logged metrics.
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
    began: Began = field(default_factory=Began, compare=False, repr=False)
    on_progress: OnProgress = field(default=ignore, compare=False, repr=False)
    on_metrics: OnMetrics = field(default=lambda stage, values: None, compare=False, repr=False)

    def open_store(self) -> "Store":
        """The store, for reading."""
        from motionkit.store.reader import Store

        return Store.open(self.store, on_progress=self.on_progress)

    @property
    def ranks(self) -> "Ranks":
        """The ranks that train this stage together."""
        from motionkit.training.networks import ALONE, present_ranks

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


@dataclass(frozen=True)
class Stage(Generic[ConfigT]):
    """A trainable stage: `train(context, config)` writes RUN/NAME/ and ends with `StageFolder.finish`.

    `builds_on(config)` names the stages whose results it reads; `train` passes the same to `StageContext.begin`.
    `check(context, config)` raises errors that can be found before any training, without other stages' results.
    `recipes` maps names to functions that make a configuration. Stages of one model may share a configuration whose
    parts are named after the stages: a change of another stage's part doesn't prevent `--resume`. Under torchrun every
    rank calls the `train` of a `shared` stage (`motionkit.training.networks`); others are trained by the first rank
    alone. `share` is its share of its system's time budget, relative to the system's other stages (`StagePlan`).
    `packed` selects the tensors of its model that generation needs (`motionkit pack`).
    """

    name: str
    description: str
    recipes: Mapping[str, Callable[[], ConfigT]]
    train: Callable[[StageContext, ConfigT], None]
    check: Callable[[StageContext, ConfigT], object] = lambda context, config: None
    shared: bool = False
    share: float = 1.0
    builds_on: Callable[[ConfigT], tuple[str, ...]] = lambda config: ()
    packed: Callable[[dict[str, Any]], dict[str, Any]] = lambda tensors: tensors

    def __post_init__(self) -> None:
        if not re.fullmatch(STAGE_NAME, self.name):
            raise UsageError(f"a stage's name is of letters, digits, '_' and '-', no '-' first, not {self.name!r}")

    def check_kept(self, context: StageContext, config: ConfigT, store_fingerprint: str) -> None:
        """Raise `RunError` if this stage was begun with other inputs than the same command would use now."""
        inputs = context.inputs(config, store_fingerprint, self.builds_on(config))
        check_resumable(context.run.stage(self.name), inputs)

    def configured(self, recipe: str, overrides: Sequence[str] = ()) -> ConfigT:
        """The configuration of a recipe, with those overrides (`a.b=c`) whose setting it has.

        Raises `UsageError`, for an unknown recipe with the known ones.
        """
        if recipe not in self.recipes:
            raise UsageError(f"stage {self.name!r} has no recipe {recipe!r}; it has: {', '.join(self.recipes)}")
        config = self.recipes[recipe]()
        known = flatten(config)
        return apply_overrides(config, [each for each in overrides if parse_override(each)[0] in known])


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


def choose_stages(name: str) -> tuple[Stage[Any], ...]:
    """The stages that `--stage NAME` selects; raises `UsageError` that lists the known ones."""
    names = plugins.names("ALL") if name == "all" else (name,)
    try:
        return tuple(plugins.load("STAGES", each) for each in names)
    except KeyError:
        known = ", ".join([*plugins.names("STAGES"), "all"])
        raise UsageError(f"no stage is called {name!r}; there are: {known}") from None
