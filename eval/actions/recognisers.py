"""The available action recognisers by name: fitted on the store, or published ones with the user's weights."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

from eval.actions.linear import fit_linear
from eval.actions.recogniser import ActionRecogniser
from eval.sets.sets import SampleSet
from motionkit.core.errors import UsageError

LINEAR_FPS = Fraction(20)


@dataclass(frozen=True)
class RecogniserSource:
    """A kind of recogniser: a published one that `load` reads from a file, or the linear one (None).

    `dataset` is the paper's name of its data set, "" for the store's own; `needs_rotations`: it takes joint rotations,
    not positions.
    """

    name: str
    title: str
    fps: Fraction
    load: Callable[[Path], ActionRecogniser] | None = None
    dataset: str = ""
    needs_rotations: bool = False
    note: str = ""

    def make(self, train: Callable[[], SampleSet], weights: Path | None) -> ActionRecogniser:
        """The recogniser, fitted on the training motions at `fps` or read from the file of weights.

        Raises `UsageError` for weights where none are read, or none where they are.
        """
        if self.load is None:
            if weights is not None:
                raise UsageError(
                    "--weights needs a published recogniser ('linear' is fitted on the store): choose one with "
                    "--evaluator humanact12, uestc or cmu-mocap"
                )
            return fit_linear(train())
        if weights is None:
            raise UsageError(f"--evaluator {self.name} needs the file of its weights: --weights FILE")
        return self.load(weights)


def find_recogniser(name: str) -> RecogniserSource:
    """A recogniser by name. Raises `UsageError` that lists the known names."""
    from eval.actions.gru import CMU_MOCAP, HUMANACT12, load_gru
    from eval.actions.uestc import TITLE, load_uestc
    from motionkit.io import uestc

    linear = RecogniserSource(
        name="linear",
        title="linear discriminants fitted on the training split",
        fps=LINEAR_FPS,
        note=(
            "Features have a variance of 1 within actions, and there is one fewer than actions. The recogniser "
            "belongs to this store: compare these numbers with no others. What it is worth is its accuracy on real "
            "motion."
        ),
    )
    published = (
        RecogniserSource(
            name=kind.name,
            title=kind.title,
            fps=kind.fps,
            load=partial(load_gru, kind=kind),
            dataset="HumanAct12" if kind is HUMANACT12 else "",
            note=(
                "Heading counts for this recogniser, and motions without hands get straight ones. Its hidden state "
                "begins at zero, in the published code at random."
            ),
        )
        for kind in (HUMANACT12, CMU_MOCAP)
    )
    rotations = RecogniserSource(
        name="uestc",
        title=TITLE,
        fps=uestc.FPS,
        load=load_uestc,
        dataset="UESTC",
        needs_rotations=True,
        note="It takes joint rotations only, and depends on the heading.",
    )
    sources = {source.name: source for source in (linear, *published, rotations)}
    if name not in sources:
        raise UsageError(f"there is no recogniser of actions {name!r}: {', '.join(sources)}")
    return sources[name]
