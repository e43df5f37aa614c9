"""A trained generative model for Python: texts or actions in, motions out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TypedDict, Unpack, overload

from motionkit.core.errors import UsageError, shown
from motionkit.core.motion import Motion
from motionkit.core.skeleton import Skeleton
from motionkit.core.timegrid import Framerate, parse_fps
from motionkit.fields.motion_field import MotionField
from motionkit.generate import models
from motionkit.generate.constraints import Constraint
from motionkit.generate.long_motions import Script, check_script, generate_scripts
from motionkit.generate.models import GenerationRequest, GenerativeModel, SamplingOptions, model_of, warn_above_training
from motionkit.generate.output import motion_name, plant_generated, sample_motion
from motionkit.training.run import find_run

Several = list[str] | tuple[str, ...]


class Drawn(TypedDict, total=False):
    """What motions follow from, besides their texts."""

    action: str | None
    seconds: int | float | None
    seed: int
    sampling: SamplingOptions | None
    plant: bool


class Options(Drawn, total=False):
    """Common parameters of `generate`'s overloads."""

    fps: Framerate | None


@dataclass(frozen=True, eq=False)
class MotionModel:
    """A trained generative model; `model` is the package's own object (docs/extending.md).

    >>> model = mk.load_model("runs/nano")
    >>> motion = model.generate("a person walks", fps=120, seconds=2)
    >>> motion.num_frames, motion.captions[0].text
    (240, 'a person walks')
    """

    model: GenerativeModel
    run: Path
    constraints: tuple[Constraint, ...] = ()

    @property
    def name(self) -> str:
        """Its name in tables."""
        return self.model.name

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of its motions."""
        return self.model.skeleton

    @property
    def max_training_fps(self) -> Fraction:
        """Highest framerate of its training data; detail above it is interpolated, not learned."""
        return self.model.max_training_fps

    @property
    def max_duration_seconds(self) -> float:
        """Longest motion generated at once; longer ones are joined from several."""
        return self.model.max_duration_seconds

    def constrained(self, *constraints: Constraint) -> "MotionModel":
        """The same model with constraints: a path, poses, joints at given instants."""
        return replace(self, constraints=constraints)

    @overload
    def generate(self, text: str | None = None, *, n: None = None, **options: Unpack[Options]) -> Motion: ...

    @overload
    def generate(self, text: str | None = None, *, n: int, **options: Unpack[Options]) -> list[Motion]: ...

    @overload
    def generate(self, text: Several, *, n: int | None = None, **options: Unpack[Options]) -> list[Motion]: ...

    def generate(
        self,
        text: str | Several | None = None,
        *,
        action: str | None = None,
        fps: Framerate | None = None,
        seconds: int | float | None = None,
        n: int | None = None,
        seed: int = 0,
        sampling: SamplingOptions | None = None,
        plant: bool = True,
    ) -> Motion | list[Motion]:
        """A motion of a text, an action, or neither; with `n`, or of several texts, a list: n of each.

        `fps` is by default the highest framerate of the training data; above it there is a warning that detail is
        interpolated. `seconds` are drawn from those of the training data by default; a motion longer than the model's
        limit is joined from several. The same seed gives the same motions at every framerate. Foot sliding is removed
        and bone lengths are fixed, unless `plant` is false (docs/plant.md). Raises `UsageError` for unsupported
        requests.

        >>> model = mk.load_model("runs/nano")
        >>> [motion.duration_seconds for motion in model.generate("a person jumps", fps=30, seconds=2, n=2, seed=1)]
        [2.0, 2.0]
        """
        rate = self.max_training_fps if fps is None else parse_fps(fps)
        warn_above_training(self.model, rate)
        drawn = self._drawn(text, n, action, seconds, seed, sampling, plant)
        motions = [
            sample_motion(field, motion_name(number, script), script, rate).logged(
                f"generate motion {number} of seed {seed} at {rate} fps ({self.name}, {self.run})"
            )
            for number, (script, field) in enumerate(drawn)
        ]
        return motions[0] if n is None and not isinstance(text, list | tuple) else motions

    def fields(self, text: str | Several | None = None, *, n: int = 1, **options: Unpack[Drawn]) -> list[MotionField]:
        """The same motions as functions of time, for poses at any instants (docs/motion-fields.md).

        >>> [field] = mk.load_model("runs/nano").fields("a person walks", seconds=2)
        >>> field.query(np.array([0.5, 1.25])).joint_positions.shape
        (2, 22, 3)
        """
        return [field for _, field in self._drawn(text, n, **options)]

    def _drawn(
        self,
        text: str | Several | None,
        n: int | None,
        action: str | None = None,
        seconds: int | float | None = None,
        seed: int = 0,
        sampling: SamplingOptions | None = None,
        plant: bool = True,
    ) -> list[tuple[Script, MotionField]]:
        """The scripts of a call with their motions; all are checked before the first is generated."""
        texts = [text or ""] if text is None or isinstance(text, str) else text
        if not isinstance(texts, list | tuple) or not all(isinstance(each, str) for each in texts):
            raise UsageError(f"expected a text, or a list of texts, not {shown(text)}")
        given = [*(() if text is None else texts), *(() if action is None else (action,))]
        if not all(each.strip() for each in given):
            raise UsageError("a text or action is empty; give neither for unconditional motion")
        if not texts or (n is not None and n < 1):
            raise UsageError("nothing to generate: give at least one text, and n of 1 or more")
        length, options = None if seconds is None else float(seconds), sampling or SamplingOptions()
        requests = [GenerationRequest(length, each, action or "", self.constraints) for each in texts]
        scripts: list[Script] = [(request,) for request in requests for _ in range(n or 1)]
        for script in dict.fromkeys(scripts):
            check_script(self.model, script, options)
        fields = [field for _, field in generate_scripts(self.model, scripts, seed=seed, sampling=options)]
        return list(zip(scripts, map(plant_generated, fields, scripts) if plant else fields, strict=True))

    def __repr__(self) -> str:
        return (
            f"MotionModel({self.name!r}, {str(self.run)!r}, {self.skeleton.num_joints} joints, up to "
            f"{self.max_duration_seconds:g} s at once, trained at up to {self.max_training_fps} fps)"
        )


def load_model(run: str | Path | None = None, name: str | None = None) -> MotionModel:
    """Load the generative model of a run, by `name` if it holds several.

    A run is a folder, its name in the folder of all runs, or the name of one that comes with motionkit (`cmu-small`);
    the default is `nano`, or `cmu-small` where `nano` is not trained. Raises `UsageError` for a missing run, and for
    one with none or several of the installed models, `MotionkitError` for a damaged or incomplete one.

    >>> mk.load_model("runs/nano").name
    'NeRM, local latents (ours)'
    """
    path = find_run(run)
    return MotionModel(models.load_model(name or model_of(path), path), path)


@overload
def generate(
    text: str | None = None, *, run: str | Path | None = None, n: None = None, **options: Unpack[Options]
) -> Motion: ...


@overload
def generate(
    text: str | None = None, *, run: str | Path | None = None, n: int, **options: Unpack[Options]
) -> list[Motion]: ...


@overload
def generate(
    text: Several, *, run: str | Path | None = None, n: int | None = None, **options: Unpack[Options]
) -> list[Motion]: ...


def generate(
    text: str | Several | None = None,
    *,
    run: str | Path | None = None,
    n: int | None = None,
    **options: Unpack[Options],
) -> Motion | list[Motion]:
    """Motions of the model of a run: `load_model(run).generate(…)`, which explains the options, for a single call.

    >>> mk.generate("a person walks", run="runs/nano", fps="30000/1001", seconds=1).fps
    Fraction(30000, 1001)
    """
    generate_motions: Callable[..., Motion | list[Motion]] = load_model(run).generate  # without its overloads
    return generate_motions(text, n=n, **options)
