"""The recognisers of actions that can be had, by name: fitted on the store, or published with weights of the user's."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from eval.actions.linear import fit_linear
from eval.actions.recogniser import ActionRecogniser
from eval.sets.sets import SampleSet
from motionkit.core.errors import UsageError

LINEAR_FPS = Fraction(20)


@dataclass(frozen=True)
class RecogniserSource:
    """A kind of recogniser: `make` gives it from the training motions at `fps` and the file of weights.

    `dataset` is what the paper calls the data that it knows, "" where it knows the store's own; `needs_rotations` says
    that it sees joint rotations, not positions.
    """

    name: str
    title: str
    fps: Fraction
    make: Callable[[Callable[[], SampleSet], Path | None], ActionRecogniser]
    dataset: str = ""
    needs_rotations: bool = False
    note: str = ""


def find_recogniser(name: str) -> RecogniserSource:
    """A recogniser by name. Raises `UsageError` with the names there are."""
    sources = _sources()
    if name not in sources:
        raise UsageError(f"there is no recogniser of actions {name!r}: {', '.join(sources)}")
    return sources[name]


def _sources() -> Mapping[str, RecogniserSource]:
    from eval.actions.gru import CMU_MOCAP, HUMANACT12, load_gru
    from eval.actions.uestc import TITLE, load_uestc
    from motionkit.formats.smpl import uestc

    sources = (
        RecogniserSource(
            "linear",
            "linear discriminants fitted on the training split",
            LINEAR_FPS,
            _fitted,
            note=(
                "Features have a variance of 1 within actions, and there is one fewer than actions. The recogniser "
                "belongs to this store: compare these numbers with no others. What it is worth is its accuracy on real "
                "motion."
            ),
        ),
        *(
            RecogniserSource(
                kind.name,
                kind.title,
                kind.fps,
                _loaded(kind.name, lambda path, kind=kind: load_gru(path, kind)),  # type: ignore[misc]
                dataset="HumanAct12" if kind is HUMANACT12 else "",
                note=(
                    "Heading counts for this recogniser, and motions without hands get straight ones. Its hidden state "
                    "begins at zero, in the published code at random."
                ),
            )
            for kind in (HUMANACT12, CMU_MOCAP)
        ),
        RecogniserSource(
            "uestc",
            TITLE,
            uestc.FPS,
            _loaded("uestc", load_uestc),
            dataset="UESTC",
            needs_rotations=True,
            note="It sees joint rotations alone; heading counts.",
        ),
    )
    return {source.name: source for source in sources}


def _fitted(train: Callable[[], SampleSet], weights: Path | None) -> ActionRecogniser:
    if weights is not None:
        raise UsageError(
            "--weights belongs to a published recogniser, and 'linear' is fitted on the store: name one with "
            "--evaluator humanact12, uestc or cmu-mocap"
        )
    return fit_linear(train())


def _loaded(
    name: str, load: Callable[[Path], ActionRecogniser]
) -> Callable[[Callable[[], SampleSet], Path | None], ActionRecogniser]:
    def make(train: Callable[[], SampleSet], weights: Path | None) -> ActionRecogniser:
        if weights is None:
            raise UsageError(f"--evaluator {name} needs the file of its weights: --weights FILE (docs/evaluators.md)")
        return load(weights)

    return make
