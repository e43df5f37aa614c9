"""Recognisers of actions: what they are given and answer, and their names, fitted on a store or published."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.sets.sets import SampleSet
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.shapes import Float64
from motionkit.io import joints_npy, uestc

FeaturesAndScores = tuple[Float64[np.ndarray, "sequences features"], Float64[np.ndarray, "sequences actions"]]


@dataclass(frozen=True, eq=False)
class ActionRecogniser:
    """Classifies motions at `fps` by `actions`; a motion's row depends on that motion alone.

    `fingerprint` is a hash of everything that the numbers depend on: definition, weights, settings. `describe` gives
    features, and scores in the order of the actions.
    """

    name: str
    fps: Fraction
    actions: tuple[str, ...]
    fingerprint: str
    describe: Callable[[SampleSet], FeaturesAndScores]

    def recognise(self, samples: SampleSet) -> FeaturesAndScores:
        """Features and scores of every sequence. Raises `MotionkitError` for an unsupported framerate or skeleton."""
        if self.fps != samples.fps:
            raise MotionkitError(
                f"{samples.name}: motions at {samples.fps} fps, but the recogniser {self.name!r} was trained at "
                f"{self.fps} fps only; resample them first"
            )
        return self.describe(samples)


@dataclass(frozen=True)
class RecogniserSource:
    """A kind of recogniser; `dataset` is the paper's name of the data set that a published one knows.

    `needs_rotations`: it sees joint rotations, not positions.
    """

    name: str
    title: str
    fps: Fraction
    note: str
    dataset: str = ""
    needs_rotations: bool = False


SOURCES = (
    RecogniserSource(
        "linear",
        "linear discriminants fitted on the training split",
        Fraction(20),
        "Features have a variance of 1 within actions, and there is one fewer than actions. The recogniser belongs to "
        "this store: compare these numbers with no others. What it is worth is its accuracy on real motion.",
    ),
    RecogniserSource(
        "humanact12",
        "Action2Motion's GRU for HumanAct12",
        joints_npy.HUMANACT12_FPS,
        "Heading counts for this recogniser, and motions without hands get straight ones. Its hidden state begins at "
        "zero, in the published code at random.",
        dataset="HumanAct12",
    ),
    RecogniserSource(
        "uestc",
        "ACTOR's ST-GCN for UESTC",
        uestc.FPS,
        "It takes joint rotations only, and depends on the heading.",
        dataset="UESTC",
        needs_rotations=True,
    ),
)


def find_recogniser(name: str) -> RecogniserSource:
    """A recogniser by name. Raises `UsageError` that lists the known names."""
    known = {source.name: source for source in SOURCES}
    if name not in known:
        raise UsageError(f"there is no recogniser of actions {name!r}: {', '.join(known)}")
    return known[name]
