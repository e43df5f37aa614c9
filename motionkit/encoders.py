"""Trained encoders by name: entry points of the group `motionkit.encoders`, each a loader from a run to an encoder.

An entry point names an `EncoderLoader`, or a plain function `load(run: Path) -> MotionEncoder` that has the name of the
stage that trains it. Interpolators need no run and are found by their names beside them.
"""

from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

from motionkit.errors import UsageError
from motionkit.interpolation.fields import INTERPOLATORS
from motionkit.motionfield import MotionEncoder
from motionkit.training.loaders import Loader, installed_loaders, loader_names, loader_of
from motionkit.training.run import RunFolder

GROUP = "motionkit.encoders"

# What an encoder may be for: frames between given ones, gaps and ends closed and continued, windows described again.
Task = Literal["interpolation", "inbetweening", "extrapolation", "reconstruction"]
COMPLETION: tuple[Task, ...] = ("interpolation", "inbetweening", "extrapolation")


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


@dataclass(frozen=True)
class EncoderLoader(Loader[MotionEncoder]):
    """A trained encoder that a package brings, as an entry point of `motionkit.encoders` names it.

    Tables look in their run for the encoders of their own task. The `preferred` one completes clips where nobody names
    another.
    """

    tasks: tuple[Task, ...] = COMPLETION
    preferred: bool = False


def trained_encoder_names() -> tuple[str, ...]:
    """Names of all installed trained encoders, sorted; whether any run holds one is another matter."""
    return loader_names(GROUP)


def installed_encoders(task: Task | None = None) -> dict[str, EncoderLoader]:
    """All installed trained encoders by name, or those for one task."""
    found = installed_loaders(GROUP, EncoderLoader)
    return {name: loader for name, loader in found.items() if task is None or task in loader.tasks}


def encoder_loader(name: str) -> EncoderLoader:
    """The loader of a trained encoder; raises `UsageError` naming those there are."""
    found = entry_points(group=GROUP, name=name)
    if not found:
        trained = ", ".join(trained_encoder_names()) or "none is installed"
        raise UsageError(
            f"no encoder is called {name!r}; interpolators: {', '.join(INTERPOLATORS)}; trained: {trained}"
        )
    return loader_of(next(iter(found)), EncoderLoader)


def load_encoder(name: str, run: Path) -> MotionEncoder:
    """The encoder of this name: an interpolator, or a trained one out of a run folder.

    Raises `UsageError` for a name that nothing has; a loader raises `MotionkitError` where the run holds none of its
    kind.
    """
    for interpolator in INTERPOLATORS.values():
        if interpolator.name == name:
            return interpolator
    return encoder_loader(name).load(run)


def runs_with(name: str, runs: Path) -> tuple[Path, ...]:
    """Run folders in `runs` that hold all stages of this trained encoder, the one trained last at the end.

    Raises `UsageError` for a name that nothing has.
    """
    loader = encoder_loader(name)
    if not runs.is_dir():
        return ()
    complete = [run for run in runs.iterdir() if loader.complete_in(run)]
    return tuple(sorted(complete, key=lambda run: (_trained_at(run, loader), run.name)))


def _trained_at(run: Path, loader: EncoderLoader) -> int:
    return RunFolder(run).stage(loader.stages[-1]).summary_path.stat().st_mtime_ns
