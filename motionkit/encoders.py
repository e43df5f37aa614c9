"""Trained encoders by name: entry points of the group `motionkit.encoders`, each a loader from a run to an encoder.

An entry point NAME = "module:load" names `load(run: Path) -> MotionEncoder`. Where NAME is also the stage that trains
it, `runs_with` finds the runs that have one. Interpolators need no run and are found by their names beside them.
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol, runtime_checkable

from motionkit.errors import UsageError
from motionkit.interpolation.fields import INTERPOLATORS
from motionkit.motionfield import MotionEncoder
from motionkit.training.run import RunFolder

GROUP = "motionkit.encoders"


@runtime_checkable
class KnowsItsTraining(Protocol):
    """An encoder that can say what it has seen; beyond that it is asked all the same, and people are told."""

    @property
    def longest_gap_seconds(self) -> float:
        """The longest time between neighbouring observed frames in training."""
        ...

    @property
    def reach_seconds(self) -> float:
        """How far beyond what is observed training went."""
        ...


def trained_encoder_names() -> tuple[str, ...]:
    """Names of all installed trained encoders, sorted; whether any run holds one is another matter."""
    return tuple(sorted({entry.name for entry in entry_points(group=GROUP)}))


def load_encoder(name: str, run: Path) -> MotionEncoder:
    """The encoder of this name: an interpolator, or a trained one out of a run folder.

    Raises `UsageError` for a name that nothing has; a loader raises `MotionkitError` where the run holds none of its
    kind.
    """
    for interpolator in INTERPOLATORS.values():
        if interpolator.name == name:
            return interpolator
    found = entry_points(group=GROUP, name=name)
    if not found:
        trained = ", ".join(trained_encoder_names()) or "none is installed"
        raise UsageError(
            f"no encoder is called {name!r}; interpolators: {', '.join(INTERPOLATORS)}; trained: {trained}"
        )
    loader: Callable[[Path], MotionEncoder] = next(iter(found)).load()
    return loader(run)


def runs_with(name: str, runs: Path) -> tuple[Path, ...]:
    """Run folders in `runs` whose stage of this name is complete, the one trained last at the end."""
    if not runs.is_dir():
        return ()
    complete = [run for run in runs.iterdir() if RunFolder(run).stage(name).is_complete]
    return tuple(
        sorted(complete, key=lambda run: (RunFolder(run).stage(name).summary_path.stat().st_mtime_ns, run.name))
    )
