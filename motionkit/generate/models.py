"""The interface of generative models: requests in, motion fields out.

A package lists its models in `MODELS` (`motionkit.core.plugins`), each a `Loader` or a plain function from a run
folder; the table code and `motionkit generate` know only this interface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from motionkit.core.errors import UsageError
from motionkit.core.progress import warn
from motionkit.core.skeleton import Skeleton
from motionkit.fields.motion_field import MotionField
from motionkit.generate.constraints import Constraint, ConstraintKind
from motionkit.training.run import Loader, installed_loaders, loader_named

if TYPE_CHECKING:
    from motionkit.training.text import TextEncoder


@dataclass(frozen=True)
class GenerationRequest:
    """A motion to generate: a duration, and a text, an action or neither as its condition.

    If both are given, a model uses the text if it was trained with texts, and the action otherwise. A duration of None
    is drawn from the training data's. Constraints need a model that supports them (`FollowsConstraints`) and a
    duration; their time begins with the motion.
    """

    duration_seconds: float | None
    text: str = ""
    action: str = ""
    constraints: tuple[Constraint, ...] = ()


@dataclass(frozen=True)
class SamplingOptions:
    """Sampling options; None is the default of the model's recipe.

    `guidance_scale` is the strength of classifier-free guidance (1: none). A model raises `UsageError` for an
    unsupported `sampler` or number of `steps`.

    >>> options = mk.SamplingOptions(guidance_scale=2.5, steps=5)
    >>> mk.generate("a person walks", run="runs/nano", fps=20, seconds=1, sampling=options).num_frames
    20
    """

    guidance_scale: float | None = None
    sampler: str | None = None
    steps: int | None = None


@runtime_checkable
class GenerativeModel(Protocol):
    """A trained model that turns requests into motion fields."""

    @property
    def name(self) -> str:
        """Name for tables."""

    @property
    def skeleton(self) -> Skeleton:
        """Skeleton of everything it generates."""

    @property
    def max_training_fps(self) -> Fraction:
        """Highest framerate in its training data; detail above it is invented."""

    @property
    def max_duration_seconds(self) -> float:
        """Longest motion of a request (l_max)."""

    def text_encoder(self) -> "TextEncoder | None":
        """The encoder of its texts, loaded on first use; None if it was trained without texts."""

    def generate(
        self,
        requests: Sequence[GenerationRequest],
        *,
        seed: int,
        sampling: SamplingOptions = SamplingOptions(),
        first: int = 0,
    ) -> list[MotionField]:
        """One field per request, in order; the same seed and requests give the same fields.

        Request i is number `first` + i of its seed, so that many requests can be split into several calls.
        """


@runtime_checkable
class ChecksRequests(Protocol):
    """A model that can validate requests before it generates any."""

    def check(self, request: GenerationRequest, sampling: SamplingOptions = SamplingOptions()) -> None:
        """Raise `UsageError` for an unsupported duration, action, text or sampling option."""


@runtime_checkable
class FollowsConstraints(Protocol):
    """A model that supports some kinds of constraints."""

    @property
    def constraint_kinds(self) -> frozenset[ConstraintKind]:
        """The supported kinds."""


def check_constraints(model: GenerativeModel, request: GenerationRequest) -> None:
    """Raise `UsageError` for constraints that a model doesn't support, or outside the motion's duration."""
    kinds = model.constraint_kinds if isinstance(model, FollowsConstraints) else frozenset()
    length = request.duration_seconds
    for each in request.constraints:
        if each.kind not in kinds:
            follows = f"follows {' and '.join(sorted(kinds))} alone" if kinds else "follows no constraints"
            raise UsageError(f"{each.name}: the model {model.name!r} {follows}: it cannot follow a {each.kind}")
        if length is None:
            raise UsageError(f"{each.name}: --seconds is needed: its instants are those of a motion of a given length")
        if each.seconds.max() > length + 1e-9:
            raise UsageError(f"{each.name}: {each.seconds.max():g} s lies outside the motion's 0 … {length:g} s")


def installed_models() -> dict[str, Loader[GenerativeModel]]:
    """All installed models by name."""
    return installed_loaders("MODELS")


def load_model(name: str, run: Path) -> GenerativeModel:
    """Load an installed model by its name, from a run folder; raises `UsageError` that lists the known ones."""
    loader: Loader[GenerativeModel] = loader_named("MODELS", name)
    return loader.load(run)


def model_of(run: Path) -> str:
    """The name of the installed model in a run.

    Raises `UsageError` if the run holds none of several models, or more than one.
    """
    installed = installed_models()
    if not installed:
        raise UsageError("no model is installed")
    trained = [name for name, loader in installed.items() if loader.begun_in(run)]
    if len(trained) > 1:
        raise UsageError(
            f"{run} holds several models, {' and '.join(trained)}: name one of them (--model {trained[0]})"
        )
    if not trained:
        first = next(iter(installed.values()))
        none = f"{run} holds none of the installed models ({', '.join(installed)})"
        lacking = none if run.is_dir() else f"there is no run {run}"
        raise UsageError(f"{lacking}: {first.train_command(run)} trains {first.title}")
    return trained[0]


def warn_above_training(model: GenerativeModel, fps: Fraction) -> None:
    """Warn about a framerate above the training data's highest (the paper's limitation, B.3)."""
    if fps > model.max_training_fps:
        warn(
            f"{float(fps):g} fps is above the {float(model.max_training_fps):g} fps of {model.name}'s fastest training "
            "data; detail beyond that is interpolated, not learned"
        )
