"""The available action recognisers by name: fitted on the store, or published ones with the user's weights."""

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
    """A kind of recogniser; `make` builds it from the training motions at `fps` or the file of weights.

    `dataset` is the paper's name of its data set, "" for the store's own; `needs_rotations`: it takes joint rotations,
    not positions.
    """

    name: str
    title: str
    fps: Fraction
    make: Callable[[Callable[[], SampleSet], Path | None], ActionRecogniser]
    dataset: str = ""
    needs_rotations: bool = False
    note: str = ""


def find_recogniser(name: str) -> RecogniserSource:
    """A recogniser by name. Raises `UsageError` that lists the known names."""
    sources = _sources()
    if name not in sources:
        raise UsageError(f"there is no recogniser of actions {name!r}: {', '.join(sources)}")
    return sources[name]


def _sources() -> Mapping[str, RecogniserSource]:
    from eval.actions.gru import CMU_MOCAP, HUMANACT12, load_gru
    from eval.actions.uestc import TITLE, load_uestc
    from motionkit.io import uestc

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
            note="It takes joint rotations only, and depends on the heading.",
        ),
    )
    return {source.name: source for source in sources}


def _fitted(train: Callable[[], SampleSet], weights: Path | None) -> ActionRecogniser:
    if weights is not None:
        raise UsageError(
            "--weights needs a published recogniser ('linear' is fitted on the store): choose one with "
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
