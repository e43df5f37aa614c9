"""The rows of the completion tables: what needs no training, and the trained encoders of runs."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from eval.sets.found import Found
from eval.sets.row_curves import CUBIC, LINEAR
from motionkit.complete.encoders import (
    EncoderLoader,
    Task,
    encoder_loader,
    installed_encoders,
    runs_with,
    trained_encoder_names,
)
from motionkit.core.errors import DamagedFileError, MotionkitError, UsageError
from motionkit.fields.interpolation.interpolators import INTERPOLATORS
from motionkit.fields.motion_field import MotionEncoder
from motionkit.training.run import RunFolder, commit, versions
from motionkit.training.stage import recorded_settings


@dataclass(frozen=True)
class Completer:
    """A row: an encoder, what it is, and what its figures depend on beside the protocol.

    `form` is what a trained network's answer is (`Form` of its settings): rows of different forms are not compared by
    their networks alone. It is empty where nothing says so. `facts` tell how it was trained.
    """

    name: str
    encoder: MotionEncoder
    note: str
    fingerprint: str
    trained: bool = False
    form: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)


HOLD = Completer("hold", INTERPOLATORS["hold"], "each given pose until the next one", "hold/1")
INTERPOLATION = (
    HOLD,
    Completer("linear", LINEAR, "straight lines through the pose's 135 numbers (rotations as two columns)", "linear/1"),
    Completer("SLERP", INTERPOLATORS["slerp"], "rotations on great arcs, root on straight lines", "slerp/1"),
    Completer(
        "Catmull-Rom",
        INTERPOLATORS["rotation-catmull-rom"],
        "Hermite curves on the logarithms of turns between quaternions",
        "catmull-rom/1",
    ),
    Completer("SQUAD", INTERPOLATORS["squad"], "spherical quadrangles, root Catmull-Rom", "squad/1"),
    Completer("cubic spline", CUBIC, "not-a-knot spline through the pose's 135 numbers", "cubic/1"),
)


def trained_completers(task: Task, run: Path | None, more: Sequence[tuple[str, Path]]) -> Found[list[Completer]]:
    """The installed encoders for a task that `run` holds, then (name, run) pairs asked for, which must be there.

    What is missing in `run` is named with the runs that have it. Raises `UsageError` for a name that no installed
    package has, `DamagedFileError`, and what loading an encoder that was asked for raises.
    """
    known = installed_encoders()
    found: list[Completer] = []
    missing: list[str] = []
    asked = {name for name, _ in more}
    for name, loader in installed_encoders(task).items():
        if run is not None and loader.complete_in(run):
            try:
                found.append(completer_of(name, run, loader.title))
            except DamagedFileError:
                raise
            except MotionkitError as error:
                missing.append(f"{loader.title}: {error}")
        elif name not in asked:
            missing.append(_told_untrained(name, loader, run))
    for name, folder in more:
        if name not in known:
            names = ", ".join(trained_encoder_names()) or "none"
            raise UsageError(f"--encoder {name}={folder.name}: trained encoders are {names}")
        found.append(completer_of(name, folder, f"{known[name].title} ({folder.name})"))
    return Found(found, tuple(missing))


def completer_of(name: str, run: Path, title: str) -> Completer:
    """The row of a run's trained encoder; raises what loading it raises."""
    loader = encoder_loader(name)
    encoder = loader.load(run)
    stage = RunFolder(run).stage(loader.stages[-1])
    digest = hashlib.sha256(stage.model_path.read_bytes()).hexdigest() if stage.model_path.is_file() else str(run)
    begun = stage.read_config() if stage.config_path.is_file() else {}  # other packages' runs may be anything
    training = recorded_settings(RunFolder(run), loader.stages[-1]).get("training", {}) if begun else {}
    return Completer(
        title,
        encoder,
        _described_training(run, training),
        # What a network answers depends on the code that asks it: another commit's figures are not this one's.
        f"{name}-{digest}-{code_version()}",
        trained=True,
        form=str(training.get("answer", {}).get("form", "")),
        facts={name: begun[name] for name in ("commit", "recipe", "seed", "config") if name in begun},
    )


def _described_training(run: Path, training: Mapping[str, Any]) -> str:
    """The run with its steps and the form of the answer, where its settings say them."""
    described, schedule, answer = [f"run {run.name!r}"], training.get("schedule", {}), training.get("answer", {})
    if schedule.get("steps") is not None:
        described.append(f"{schedule['steps']:,} steps of {schedule.get('batch_size')}")
    if answer.get("form") == "plain":
        described.append("plain")
    elif answer.get("form") is not None:
        described.append(f"{answer['form']} corrections of {answer.get('base')}")
    return ", ".join(described)


@cache
def code_version() -> str:
    """The commit of this code, or the package's version where there is no checkout."""
    return commit() or versions()["motionkit"]


def _told_untrained(name: str, loader: EncoderLoader, run: Path | None) -> str:
    others = [] if run is None else [path.name for path in runs_with(name, run.parent)]
    if others:
        run_name = run.name if run else ""
        return f"{loader.title}: run {run_name!r} has none; --encoder {name}={others[-1]} shows that of another"
    return f"{loader.title}: not trained ({loader.train_command(run)})"
