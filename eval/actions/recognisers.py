"""Recognisers of actions, by their names: fitted on a store, or published."""

from dataclasses import dataclass
from fractions import Fraction

from motionkit.core.errors import UsageError
from motionkit.io import joints_npy, uestc


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
    for source in SOURCES:
        if source.name == name:
            return source
    raise UsageError(f"there is no recogniser of actions {name!r}: {', '.join(source.name for source in SOURCES)}")
