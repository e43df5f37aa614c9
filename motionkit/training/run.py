"""Run folders: RUN/STAGE/ has config.json, metrics.jsonl, checkpoint.safetensors, the stage's results, summary.json.

`config.json` records settings and inputs (recipe values, seed, store fingerprint, versions); `summary.json` marks the
stage as complete. SHA256SUMS is then the record of these files, and each is compared with it when it is read.
"""

import importlib.metadata
import json
import platform
import subprocess
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from motionkit.core.errors import DamagedFileError, MotionkitError, UsageError
from motionkit.core.files import (
    LOCK,
    RECORD,
    is_temporary,
    locked_folder,
    naming,
    read_json,
    read_record,
    remove_entry,
    sha256_of,
    sync,
    write_json,
    write_record,
    write_whole,
)
from motionkit.core.plain_text import shown
from motionkit.training.config import ConfigLike, flatten, to_plain

# A pattern. Without a hyphen first, as options have.
STAGE_NAME = r"\w[\w-]*"
SHOWN_SETTINGS = 6
# Keys of config.json that others read.
CONFIG_TYPES = {"config": dict, "recipe": str, "seed": int, "store_fingerprint": str, "builds_on": dict}
RECORDED_PACKAGES = ("motionkit", "torch", "numpy", "scipy", "safetensors")


# Called with a stage's name and logged metrics.
OnMetrics = Callable[[str, Mapping[str, float]], None]
HINT = "restore it from a copy, or train the stage again with --overwrite"


def ignore_metrics(stage: str, values: Mapping[str, float]) -> None:
    """Ignore metrics."""


class RunError(MotionkitError):
    """A run folder that lacks a required result, or has an unsuitable one."""


def versions() -> dict[str, str]:
    """Python, platform and the packages that affect a run's numbers."""
    found = {name: importlib.metadata.version(name) for name in RECORDED_PACKAGES}
    return {"python": platform.python_version(), "platform": platform.platform(), **found}


@dataclass(frozen=True)
class StageFolder:
    """A stage's folder inside a run; owns the names of its files. `on_metrics` is called with logged metrics."""

    path: Path
    on_metrics: Callable[[Mapping[str, float]], None] = field(default=lambda _: None, compare=False, repr=False)

    @property
    def config_path(self) -> Path:
        """Settings and inputs: config.json."""
        return self.path / "config.json"

    @property
    def metrics_path(self) -> Path:
        """One JSON object per logged step: metrics.jsonl."""
        return self.path / "metrics.jsonl"

    @property
    def checkpoint_path(self) -> Path:
        """Everything needed to resume: checkpoint.safetensors."""
        return self.path / "checkpoint.safetensors"

    @property
    def model_path(self) -> Path:
        """The trained model: model.safetensors."""
        return self.path / "model.safetensors"

    @property
    def summary_path(self) -> Path:
        """Final metrics; its presence marks the stage as complete: summary.json."""
        return self.path / "summary.json"

    @property
    def budget_path(self) -> Path:
        """Number of steps of a processor time budget, if one was given: budget.json."""
        return self.path / "budget.json"

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
        config = self._read(self.config_path)
        for name, kind in CONFIG_TYPES.items():
            if name in config and not isinstance(config[name], kind):
                raise DamagedFileError(self.config_path, f"{name} is {shown(config[name])}", HINT)
        for name, sha256 in config.get("builds_on", {}).items():
            if not isinstance(sha256, str):
                raise DamagedFileError(self.config_path, f"{shown(name)} in builds_on is {shown(sha256)}", HINT)
        return config

    def read_summary(self) -> dict[str, Any]:
        """The final metrics; raises `RunError` if the stage is not complete, `DamagedFileError`."""
        return self._read(self.summary_path)

    def check(self) -> None:
        """Raise `RunError` if the stage is not complete, `DamagedFileError` for a damaged file."""
        self.read_config()
        self.read_summary()
        if not self.model_path.is_file():
            raise RunError(f"{self.path} is called complete, but has no {self.model_path.name}")
        check_recorded(self.model_path, HINT)

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
        budget = self._read(self.budget_path)
        for name, value in budget.items():
            if not isinstance(value, float | int) or isinstance(value, bool):
                raise DamagedFileError(self.budget_path, f"{name} is {shown(value)}", HINT)
        return budget

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
            check_recorded(self.metrics_path, HINT)
        lines = self.metrics_path.read_text(encoding="utf-8", errors="replace").splitlines()
        return [values for values in map(_metrics_of, lines) if values is not None]

    def keep_metrics(self, step: int) -> None:
        """Drop what was logged after a step, as a checkpoint of that step is resumed."""
        kept = [values for values in self.read_metrics() if values["step"] <= step]
        if self.metrics_path.is_file():
            write_whole(self.metrics_path, "".join(json.dumps(values) + "\n" for values in kept))

    def sync_metrics(self) -> None:
        """Flush metrics.jsonl to the disk, so that no checkpoint is ahead of it."""
        if self.metrics_path.is_file():
            sync(self.metrics_path)

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Write the final metrics, which marks the stage as complete, and record the files' sha256."""
        budget = self.read_budget() if self.budget_path.is_file() else {}
        write_json(self.summary_path, {**summary, **budget})
        paths = (self.config_path, self.metrics_path, self.model_path, self.summary_path)
        write_record(self.path, [path.name for path in paths if path.is_file()])

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the stage's lock during a training; raises `BusyError` while another process holds it."""
        with locked_folder(
            self.path, busy=f"another process is training {self.path}: wait until it has ended, or name another --run"
        ):
            yield

    def _read(self, path: Path) -> dict[str, Any]:
        if not path.is_file():
            raise RunError(
                f"{path} does not exist: stage {self.path.name!r} of run {str(self.path.parent)!r} is not trained "
                f"(motionkit train --stage {self.path.name} --run {self.path.parent.name})"
            )
        if self.is_complete:
            check_recorded(path, HINT)
        return read_json(path, HINT)


def check_recorded(path: Path, hint: str) -> None:
    """Raise `DamagedFileError` for a file that is not what its folder's record of sha256 says, if it has one."""
    if (path.parent / RECORD).is_file():
        recorded = read_record(path.parent, hint).get(path.name)
        if recorded is not None and recorded != sha256_of(path):
            raise DamagedFileError(path, f"its content is not what {RECORD} says", hint)


def _metrics_of(line: str) -> dict[str, float] | None:
    """A line of metrics.jsonl; None for one that was cut off or is none."""
    try:
        values = json.loads(line)
    except (ValueError, RecursionError):
        return None
    is_whole = isinstance(values, dict) and "step" in values
    return values if is_whole and all(isinstance(value, int | float) for value in values.values()) else None


@dataclass(frozen=True)
class RunFolder:
    """A run: one subfolder per trained stage."""

    path: Path

    def stage(self, name: str) -> StageFolder:
        """The folder of a stage, which need not exist yet."""
        return StageFolder(self.path / name)

    def fingerprints(self, stages: Iterable[str]) -> dict[str, str]:
        """Hexadecimal sha256 of the models of those stages that have one."""
        paths = {name: self.stage(name).model_path for name in stages}
        return {name: sha256_of(path) for name, path in paths.items() if path.is_file()}


def weights_sha256(run: Path) -> dict[str, str]:
    """Hexadecimal sha256 of every stage's trained weights; raises `DamagedFileError`."""
    paths = sorted(run.glob("*/model.safetensors"))
    for path in paths:
        check_recorded(path, HINT)
    return {path.parent.name: sha256_of(path) for path in paths}


@dataclass(frozen=True)
class StageOrigin:
    """The inputs of a stage's training: settings, seed, store, the run's stages that it builds on (by sha256), and the
    budget of processor time if any."""

    config: ConfigLike
    recipe: str
    seed: int
    store_fingerprint: str
    builds_on: Mapping[str, str]
    budget_seconds: float | None = None

    def plain(self) -> dict[str, Any]:
        """As JSON, without a budget if none was given."""
        found = {**vars(self), "config": to_plain(self.config), "builds_on": dict(self.builds_on)}
        return {name: value for name, value in found.items() if value is not None}


def begin_stage(folder: StageFolder, origin: StageOrigin, *, store: str, resume: bool, overwrite: bool) -> None:
    """Create a stage's folder and write its config.json, or check that an existing one can be resumed.

    Raises `UsageError` if the folder exists and neither `resume` nor `overwrite` is set, and `RunError` if the
    stage was begun from other inputs.
    """
    if resume:
        check_resumable(folder, origin)
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
    write_json(folder.config_path, {"stage": folder.path.name, **origin.plain(), "store": store, **code})


def check_resumable(folder: StageFolder, origin: StageOrigin) -> None:
    """Raise `RunError` if a stage was begun from other inputs, or has files but no config.json."""
    if folder.config_path.is_file():
        check_same(folder, origin)
    elif _holds_something(folder):
        raise RunError(
            f"{folder.path} cannot be resumed, for it has no {folder.config_path.name}: train the stage again with "
            f"--overwrite"
        )


def _holds_something(folder: StageFolder) -> bool:
    """Whether a stage was begun there; not if it was killed before writing its config.json."""
    if not folder.path.exists():
        return False
    return any(entry.name != LOCK and not is_temporary(entry) for entry in folder.path.iterdir())


def abandon_stage(folder: StageFolder) -> None:
    """Delete a stage's files, so that it counts as not begun."""
    clear_stage(folder)
    folder.config_path.unlink()


def clear_stage(folder: StageFolder) -> None:
    """Delete a stage's files except its lock and config.json, which the next training replaces.

    In this order a killed process leaves no folder that counts as complete, or that another training could resume.
    """
    first = [folder.summary_path, folder.path / RECORD, folder.checkpoint_path]
    for path in [*first, *sorted(folder.path.iterdir())]:
        if path not in (folder.config_path, folder.path / LOCK):
            remove_entry(path)


def copy_stage(source: StageFolder, target: StageFolder) -> None:
    """Replace `target` by a copy of a complete stage without its checkpoint."""
    if target.path.exists():
        clear_stage(target)
    # The last file marks it as complete.
    for path in source.result_paths:
        if path.is_file():
            write_whole(target.path / path.name, path.read_bytes())


def check_same(folder: StageFolder, origin: StageOrigin) -> None:
    """Raise `RunError` if a stage was begun with other settings, seed or store, or if a stage that it builds on was
    trained again since.

    Old runs that did not record what they build on are accepted. Settings that did not exist then had their default;
    "auto" matches the recorded choice.
    """
    begun, stage, run = folder.read_config(), folder.path.name, folder.path.parent.name
    again = f"train it again (motionkit train --stage {stage} --run {run} --overwrite), or use another --run"
    for name, sha256 in origin.builds_on.items():
        known = begun.get("builds_on", {}).get(name, sha256)
        if known != sha256:
            raise RunError(
                f"{folder.path} was begun upon another {name} (sha256 {known[:16]}, now {sha256[:16]}), which has been "
                f"trained again since: {again}"
            )
    for name, was, now in (
        ("seed", begun.get("seed"), origin.seed),
        ("store fingerprint", begun.get("store_fingerprint"), origin.store_fingerprint),
        ("budget in seconds", begun.get("budget_seconds"), origin.budget_seconds),
    ):
        if was != now:
            begun_with = f"{name} {shown(was)}, not {now!r}"
            raise RunError(f"{folder.path} was begun with {begun_with}: ask for the same, or {again}")
    config = origin.config
    settings_then = _leaves(to_plain(type(config)())) | _leaves(begun.get("config", {}))
    settings_now = _leaves(to_plain(config))
    changed = [
        key
        for key in {**settings_then, **settings_now}
        if settings_then.get(key) != settings_now.get(key) and settings_now.get(key) != "auto"
        if concerns(stage, key, config)
    ]
    if changed:
        differing = [
            f"{key} {settings_then.get(key)!r} → {settings_now.get(key)!r}" for key in changed[:SHOWN_SETTINGS]
        ]
        if len(changed) > SHOWN_SETTINGS:
            differing.append(f"{len(changed) - SHOWN_SETTINGS} more")
        recipes = (
            f"recipe {begun.get('recipe')!r} → {origin.recipe!r}: " if begun.get("recipe") != origin.recipe else ""
        )
        raise RunError(
            f"{folder.path} was begun with other settings ({recipes}{', '.join(differing)}): use the same ones, or "
            f"{again}"
        )


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
        before = begun.get("budget_seconds")
        budget = "without a budget" if before is None else f"with a budget of {before:g} s"
        raise RunError(f"{folder.path} was trained {budget}, not with one of {budget_seconds:g} s: {again}")


def concerns(stage: str, key: str, config: ConfigLike) -> bool:
    """Whether a dotted setting affects a stage: parts named after other stages of the recipe don't."""
    parts = {leaf.partition(".")[0] for leaf in flatten(config) if "." in leaf}
    return stage not in parts or key.partition(".")[0] not in parts - {stage}


def _leaves(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            found |= _leaves(value, f"{prefix}{name}.")
        else:
            found[prefix + name] = value
    return found


def commit(code: Path = Path(__file__)) -> str | None:
    """The commit of this code, if it runs from its own git checkout.

    An installation inside another project's checkout does not count.
    """
    code = code.resolve()

    def git(*arguments: str) -> str:
        done = subprocess.run(
            ("git", *arguments), cwd=code.parent, capture_output=True, text=True, timeout=10, check=True
        )
        return done.stdout.strip()

    try:
        git("ls-files", "--error-unmatch", code.name)  # fails for untracked files
        return git("rev-parse", "HEAD")
    except (OSError, subprocess.SubprocessError):
        return None
