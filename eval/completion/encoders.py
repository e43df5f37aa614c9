"""The rows of the completion tables: interpolators, and the trained encoders of runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from eval.sets.sets import Missing
from motionkit.core.errors import DamagedFileError
from motionkit.core.kinematics import closest_rotations, matrix_to_quaternion, two_columns
from motionkit.core.shapes import Float64
from motionkit.edit.encoders import installed_encoders
from motionkit.fields.interpolation import INTERPOLATORS, CurveKind, curve
from motionkit.fields.motion_field import (
    BatchEncoder,
    Joints,
    MotionEncoder,
    Observation,
    Poses,
    at_fps,
    check_observed_alike,
)
from motionkit.training.run import RunFolder, Task, loader_named


@dataclass(frozen=True)
class RowCurves:
    """A batch encoder by curves through root position and two columns of each rotation, made perpendicular again.

    Beyond the observed span values continue at constant velocity. Gram-Schmidt favours a joint's first column, so
    results depend on the skeleton's rest pose.
    """

    kind: CurveKind

    def query_many(
        self, observations: Sequence[Observation], times_seconds: Float64[np.ndarray, "times"]
    ) -> list[Poses]:
        """Poses of many motions at the same times; see `motionkit.fields.motion_field.BatchEncoder`."""
        joints = Joints.stacked([Joints.of(observation.poses, observation.skeleton) for observation in observations])
        observed = observations[0].times_seconds
        columns = curve(self.kind, observed, two_columns(joints.rotations))(times_seconds)
        rotations = matrix_to_quaternion(closest_rotations(columns))
        bones = curve(self.kind, observed, joints.bones).clamped(times_seconds)
        root = curve(self.kind, observed, joints.root)(times_seconds)
        positions = Joints(rotations, bones, root).positions(observations[0].skeleton)
        return [
            Poses(np.ascontiguousarray(positions[:, motion]), rotations[:, motion].astype(np.float32))
            for motion in range(len(observations))
        ]


LINEAR, CUBIC = RowCurves("linear"), RowCurves("cubic")


@dataclass(frozen=True)
class Completer:
    """A row: an encoder, its description, and of a trained one the weights' hash and `facts` of its training.

    `form` is the form of a trained network's output (`Form` of its settings), or empty: rows of different forms are
    not a comparison of networks alone.
    """

    name: str
    encoder: MotionEncoder | BatchEncoder
    note: str
    trained: bool = False
    form: str = ""
    weights_sha256: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)


HOLD = Completer("hold", INTERPOLATORS["hold"], "each given pose until the next one")
INTERPOLATION = (
    HOLD,
    Completer("linear", LINEAR, "straight lines through the pose's 135 numbers (rotations as two columns)"),
    Completer("SLERP", INTERPOLATORS["slerp"], "rotations on great arcs, root on straight lines"),
    Completer(
        "Catmull-Rom",
        INTERPOLATORS["rotation-catmull-rom"],
        "Hermite curves on the logarithms of turns between quaternions",
    ),
    Completer("SQUAD", INTERPOLATORS["squad"], "spherical quadrangles, root Catmull-Rom"),
    Completer("cubic spline", CUBIC, "not-a-knot spline through the pose's 135 numbers"),
)


def trained_completers(
    task: Task, run: Path | None, more: Sequence[tuple[str, Path]], missing: Missing
) -> list[Completer]:
    """The installed encoders for a task that `run` holds, then requested (name, run) pairs, which must exist.

    Encoders missing in `run` are reported; without a run, none is missing. Raises `UsageError` for an unknown name,
    `DamagedFileError`, and what loading a requested encoder raises.
    """
    completers: list[Completer] = []
    requested = {name for name, _ in more}
    for name, loader in installed_encoders(task).items():
        if run is not None and loader.complete_in(run):
            with missing.skipping(loader.title, raising=(DamagedFileError,)):
                completers.append(completer_of(name, run))
        elif run is not None and name not in requested:
            missing.add(f"{loader.title}: not trained ({loader.train_command(run)})")
    for name, folder in more:
        row = completer_of(name, folder)
        completers.append(replace(row, name=f"{row.name} ({folder.name})"))
    return completers


def completer_of(name: str, run: Path) -> Completer:
    """The row of a run's trained encoder; raises what loading it raises."""
    loader = loader_named("ENCODERS", name)
    encoder = loader.load(run)
    folder, stage = RunFolder(run), loader.stages[-1]
    # Another package's run may have no config.json.
    recorded = folder.stage(stage).read_config() if folder.stage(stage).config_path.is_file() else {}
    training = recorded.get("config", {}).get("training", {})
    schedule, output = training.get("schedule", {}), training.get("answer", {})
    form = output.get("form", "")
    notes = [f"run {run.name!r}"]
    if "steps" in schedule:
        notes.append(f"{schedule['steps']:,} steps of {schedule['batch_size']}")
    if form:
        notes.append(form if form == "plain" else f"{form} corrections of {output['base']}")
    return Completer(
        encoder.name,
        encoder,
        ", ".join(notes),
        trained=True,
        form=form,
        weights_sha256=folder.fingerprints([stage]).get(stage, ""),
        facts={key: recorded[key] for key in ("commit", "recipe", "seed", "config") if key in recorded},
    )


def query_many(
    encoder: MotionEncoder | BatchEncoder,
    observations: Sequence[Observation],
    times_seconds: Float64[np.ndarray, "times"],
    fps: Fraction,
) -> list[Poses]:
    """Poses of many motions, observed at the same times, at `times_seconds`: batched if the encoder can.

    Times may lie beyond the observed span; fields that depend on the framerate get `fps`. Raises `ValueError` for
    motions of different times or joints, and what the encoder raises.
    """
    check_observed_alike(observations)
    if isinstance(encoder, BatchEncoder):
        return encoder.query_many(observations, times_seconds)
    before = max(0.0, observations[0].start_seconds - float(times_seconds.min()))
    after = max(0.0, float(times_seconds.max()) - observations[0].end_seconds)
    fields = (encoder.encode(observation, before_seconds=before, after_seconds=after) for observation in observations)
    return [at_fps(field, fps).query(times_seconds) for field in fields]
