"""Trained encoders by name, each with a loader from a run to an encoder.

A package lists its encoders in `ENCODERS` (`motionkit.core.plugins`), each a `Loader`, or a plain function
`load(run: Path) -> MotionEncoder` that has the name of the stage that trains it. Interpolators need no run and are
found by their names beside them.
"""

import math
from dataclasses import dataclass
from pathlib import Path

from motionkit.core import plugins
from motionkit.core.errors import UsageError
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, counterpart_joints
from motionkit.fields.anchoring import Anchored
from motionkit.fields.interpolation import INTERPOLATORS, Settling
from motionkit.fields.motion_field import MotionEncoder
from motionkit.fields.transfer import Transferred
from motionkit.training.run import Loader, RunFolder, Task, find_run, installed_loaders, loader_named


def installed_encoders(task: Task | None = None) -> dict[str, Loader[MotionEncoder]]:
    """All installed trained encoders by name, or those for one task."""
    loaders: dict[str, Loader[MotionEncoder]] = installed_loaders("ENCODERS")
    return {name: loader for name, loader in loaders.items() if task is None or task in loader.tasks}


def runs_with(name: str, runs: Path) -> tuple[Path, ...]:
    """Run folders in `runs` with all stages of this trained encoder, the most recent last.

    Raises `UsageError` for an unknown name.
    """
    loader = loader_named("ENCODERS", name)

    def trained_at(run: Path) -> int:
        return RunFolder(run).stage(loader.stages[-1]).summary_path.stat().st_mtime_ns

    complete = [run for run in runs.iterdir() if loader.complete_in(run)] if runs.is_dir() else []
    return tuple(sorted(complete, key=lambda run: (trained_at(run), run.name)))


# Of all interpolators the one with the smallest errors on captures (docs/complete.md); its acceleration is continuous.
BASE = Settling(INTERPOLATORS["rotation-cubic"])
# Those that turn joints: beyond the ends they come to rest.
SETTLING = frozenset({"slerp", "rotation-catmull-rom", "squad", "rotation-cubic"})
ALIASES = {"spline": "rotation-cubic"}


@dataclass(frozen=True)
class ChosenEncoder:
    """An encoder and its name; `explanation` says why it was chosen and how to choose another.

    A trained one supports the 22 joints only, and may state the range of its training: `longest_gap_seconds` between
    observed frames, and `reach_seconds` beyond them.
    """

    name: str
    encoder: MotionEncoder
    is_trained: bool
    explanation: str

    @property
    def longest_gap_seconds(self) -> float:
        """The longest gap in its training; infinite if unknown."""
        return float(getattr(self.encoder, "longest_gap_seconds", math.inf))

    @property
    def reach_seconds(self) -> float:
        """The longest extrapolation in its training; infinite if unknown."""
        return float(getattr(self.encoder, "reach_seconds", math.inf))

    @property
    def supports_continuation(self) -> bool:
        """Whether it extrapolates at constant velocity."""
        return not self.is_trained and self.name not in (*SETTLING, "hold")

    def for_skeleton(self, skeleton: Skeleton) -> tuple[MotionEncoder, str]:
        """The encoder for a skeleton, and a reason if it is another because this one does not support it."""
        if not self.is_trained:
            return self.encoder, ""
        try:
            counterpart_joints(skeleton)
        except SkeletonMapError as error:
            return BASE, f"{self.name} does not support its skeleton, using {BASE.name}: {error}"
        return Transferred(Anchored(self.encoder), BASE), ""


def choose_encoder(name: str | None, run: str | None, runs: Path) -> ChosenEncoder:
    """The encoder of this name, an interpolator or a trained one of a run; raises `UsageError` if there is none.

    Without a name it is the preferred trained one, of the run or of the most recent one, or else an interpolator.
    """
    if name == "":
        raise UsageError("a name of an encoder is empty, expected one such as spline")
    if name is not None:
        name = ALIASES.get(name, name)
        interpolator = next((encoder for method, encoder in INTERPOLATORS.items() if method == name), None)
        if interpolator is None:
            if name not in plugins.names("ENCODERS"):
                trained = ", ".join(plugins.names("ENCODERS")) or "none is installed"
                known = f"interpolators: {', '.join(INTERPOLATORS)}; trained: {trained}"
                raise UsageError(f"no encoder is called {name!r}; {known}")
            return _trained(name, run, runs)
        if run is not None:
            raise UsageError(f"{name} is an interpolator, which no run holds: leave out run")
        encoder = Settling(interpolator) if name in SETTLING else interpolator
        return ChosenEncoder(name, encoder, False, f"{name}, an interpolator")
    preferred = next((name for name, loader in installed_encoders().items() if loader.preferred), None)
    if preferred is not None and (run is not None or runs_with(preferred, runs)):
        return _trained(preferred, run, runs)
    if run is not None:
        raise UsageError(f"run {run}: give its encoder as model ({', '.join(plugins.names('ENCODERS')) or 'none'})")
    reason = ""
    if preferred is not None:
        command = loader_named("ENCODERS", preferred).train_command()
        reason = f", since no run in {runs} has a trained {preferred}: {command} trains one"
    return ChosenEncoder(BASE.name, BASE, False, f"{BASE.name}, an interpolator{reason}")


def _trained(name: str, run: str | None, runs: Path) -> ChosenEncoder:
    loader: Loader[MotionEncoder] = loader_named("ENCODERS", name)
    if run is None:
        trained = runs_with(name, runs)
        if not trained:
            raise UsageError(
                f"no run in {runs} has a stage {loader.stages[-1]!r} that is complete: {loader.train_command()}, or "
                "give the run"
            )
        place = trained[-1]
    else:
        place = find_run(run, runs)
    encoder = loader.load(place)
    return ChosenEncoder(name, encoder, True, f"{encoder.name}, trained in {place}")
