"""Which encoder completes: the one that is asked for, else the preferred trained one, else the best interpolator."""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeGuard

from motionkit.anchoring import Anchored
from motionkit.encoders import (
    KnowsItsTraining,
    encoder_loader,
    installed_encoders,
    runs_with,
    trained_encoder_names,
)
from motionkit.errors import UsageError
from motionkit.interpolation.fields import INTERPOLATORS, Method
from motionkit.interpolation.settling import Settling
from motionkit.motionfield import MotionEncoder
from motionkit.skeleton import Skeleton
from motionkit.skeleton_transfer import Transferred, counterpart_joints
from motionkit.skeletons.mapping import SkeletonMapError

# Of all interpolators the one with the smallest errors on captures (docs/complete.md); its acceleration is continuous.
BASE = Settling(INTERPOLATORS["rotation-cubic"])
# Those that turn joints: beyond the ends they come to rest.
SETTLING = frozenset({"slerp", "rotation-catmull-rom", "squad", "rotation-cubic"})
ALIASES = {"spline": "rotation-cubic"}


@dataclass(frozen=True)
class ChosenEncoder:
    """An encoder under the name by which people know it; `explanation` says why this one and how to have another.

    A trained one knows the 22 joints only.
    """

    name: str
    encoder: MotionEncoder
    is_trained: bool
    explanation: str

    @property
    def longest_gap_seconds(self) -> float | None:
        """Longest time without a frame in its training, None where it does not say."""
        return self.encoder.longest_gap_seconds if isinstance(self.encoder, KnowsItsTraining) else None

    @property
    def reach_seconds(self) -> float | None:
        """How far beyond the ends its training went, None where it does not say."""
        return self.encoder.reach_seconds if isinstance(self.encoder, KnowsItsTraining) else None

    @property
    def goes_on(self) -> bool:
        """Whether beyond the ends it goes on at constant velocity."""
        return not self.is_trained and self.name not in (*SETTLING, "hold")

    def for_skeleton(self, skeleton: Skeleton) -> tuple[MotionEncoder, str]:
        """The encoder to use on a skeleton; and if that is another, because this one does not know it, why."""
        if not self.is_trained:
            return self.encoder, ""
        try:
            counterpart_joints(skeleton)
        except SkeletonMapError as error:
            return BASE, f"{self.name} does not know its skeleton, {BASE.name} is used: {error}"
        return Transferred(Anchored(self.encoder), BASE), ""


def choose_encoder(name: str | None, run: str | None, runs: Path) -> ChosenEncoder:
    """The encoder of a name, an interpolator or a trained one of a run; raises `UsageError` where there is none.

    Without a name it is the preferred trained one, of the run or of the one trained last, or else an interpolator.
    """
    if name == "":
        raise UsageError("a name of an encoder is empty: --model spline, --compare slerp,spline")
    name = ALIASES.get(name, name) if name else name
    if name is not None and _is_interpolator(name):
        if run is not None:
            raise UsageError(f"--model {name} is an interpolator, which no run holds: leave --run out")
        encoder = INTERPOLATORS[name]
        settling = Settling(encoder) if name in SETTLING else encoder
        return ChosenEncoder(name, settling, False, f"{name}, an interpolator")
    if name is not None:
        return _trained(name, run, runs)
    preferred = next((name for name, loader in installed_encoders().items() if loader.preferred), None)
    if preferred is not None and (run is not None or runs_with(preferred, runs)):
        return _trained(preferred, run, runs)
    if run is not None:
        raise UsageError(f"--run {run}: name its encoder with --model ({', '.join(trained_encoder_names()) or 'none'})")
    return ChosenEncoder(BASE.name, BASE, False, f"{BASE.name}, an interpolator{_why_untrained(preferred, runs)}")


def _why_untrained(preferred: str | None, runs: Path) -> str:
    if preferred is None:
        return ""
    command = encoder_loader(preferred).train_command()
    return f", for no run in {runs} has a trained {preferred}: {command} trains one"


def _is_interpolator(name: str) -> TypeGuard[Method]:
    return name in INTERPOLATORS


def _trained(name: str, run: str | None, runs: Path) -> ChosenEncoder:
    loader = encoder_loader(name)
    if run is None:
        found = runs_with(name, runs)
        if not found:
            raise UsageError(
                f"no run in {runs} has a stage {loader.stages[-1]!r} that is complete: {loader.train_command()}, or "
                "name the run with --run"
            )
        place = found[-1]
    else:
        # A path where it is one, else a name in the folder of all runs, as everywhere.
        place = Path(run) if Path(run).is_dir() and not (runs / run).is_dir() else runs / run
    encoder = loader.load(place)
    return ChosenEncoder(name, encoder, True, f"{encoder.name}, trained in {place}")
