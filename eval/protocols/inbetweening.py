"""What is given of a window and what is scored: in-betweening (PA-HiRes, Table 3; LaFAN1), and extrapolation.

Source of the in-betweening protocol: Harvey et al. 2020 (ubisoft-laforge-animation-dataset), spans and framerate those
of its benchmark. Extrapolation has no published protocol; this is motionkit's own (docs/metrics.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from motionkit.formats.bvh.lafan1 import NUM_PAST_FRAMES

INBETWEENING_VERSION = "inbetweening/1"
EXTRAPOLATION_VERSION = "extrapolation/1"


@dataclass(frozen=True)
class Question:
    """Frames of a window: those that are given and those that are asked for, and the table's name for it."""

    label: str
    given: Int64[np.ndarray, "given"]
    asked: Int64[np.ndarray, "asked"]

    @property
    def last(self) -> int:
        """The last frame of the window that this needs."""
        return int(max(self.given.max(), self.asked.max()))


def gaps(lengths: Sequence[int] = (5, 15, 30, 45)) -> tuple[Question, ...]:
    """10 past frames and the first future one given, the n between them asked for."""
    return tuple(
        Question(
            f"{length} frames",
            np.append(np.arange(NUM_PAST_FRAMES), NUM_PAST_FRAMES + length),
            np.arange(NUM_PAST_FRAMES, NUM_PAST_FRAMES + length),
        )
        for length in lengths
    )


def continuations(lengths: Sequence[int] = (5, 15, 30), num_given: int = 30) -> tuple[Question, ...]:
    """A second at 30 fps given, the n frames after it asked for; then a second given and the n frames before it.

    The given second is the first one of the window, or the last one of the same 60 frames.
    """
    longest = max(lengths)
    after = tuple(
        Question(f"after: {length}", np.arange(num_given), np.arange(num_given, num_given + length))
        for length in lengths
    )
    before = tuple(
        Question(f"before: {length}", np.arange(longest, longest + num_given), np.arange(longest - length, longest))
        for length in lengths
    )
    return (*after, *before)
