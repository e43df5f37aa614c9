"""Given and scored frames of a window: in-betweening (PA-HiRes, Table 3; LaFAN1), and extrapolation.

Source of the in-betweening protocol: Harvey et al. 2020 (ubisoft-laforge-animation-dataset), spans and framerate those
of its benchmark. Extrapolation has no published protocol; this is motionkit's own (docs/metrics.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from motionkit.core.shapes import Bool, Int64

NUM_PAST_FRAMES = 10
INBETWEENING_VERSION = "inbetweening/1"
EXTRAPOLATION_VERSION = "extrapolation/1"


@dataclass(frozen=True)
class Question:
    """Given and requested frames of a window, and the table's name for them."""

    label: str
    given: Int64[np.ndarray, "given"]
    asked: Int64[np.ndarray, "asked"]


def gaps(lengths: Sequence[int] = (5, 15, 30, 45)) -> tuple[Question, ...]:
    """10 past frames and the first future one are given, the n between them requested."""
    return tuple(
        Question(
            f"{length} frames",
            np.append(np.arange(NUM_PAST_FRAMES), NUM_PAST_FRAMES + length),
            np.arange(NUM_PAST_FRAMES, NUM_PAST_FRAMES + length),
        )
        for length in lengths
    )


def continuations(lengths: Sequence[int] = (5, 15, 30), num_given: int = 30) -> tuple[Question, ...]:
    """A second at 30 fps is given, the n frames after it requested; and likewise backwards.

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


VERSION = "interpolation/1"
INTEGER_SCALES = tuple(Fraction(scale) for scale in (2, 3, 4, 5))
OTHER_SCALES = tuple(Fraction(scale) for scale in ("1.2", "2.4", "3.6", "4.8"))


@dataclass(frozen=True)
class InterpolationProtocol:
    """Clips of `num_kept` given frames; at scale s frame ⌊i·s⌋ is the i-th given one, at its true time.

    Clips start at every multiple of the span of the largest scale, `clip_frames`, so that all scales of both tables
    use the same parts of the same takes, with the same number of given frames.
    """

    num_kept: int = 16
    largest_scale: Fraction = Fraction(5)

    @property
    def clip_frames(self) -> int:
        """Frames between the starts of neighbouring clips: the span of the largest scale."""
        return self.span_frames(self.largest_scale)

    def kept_frames(self, scale: Fraction) -> Int64[np.ndarray, "kept"]:
        """⌊i·s⌋ for i = 0 … N − 1, exactly; raises `ValueError` for scales outside (1, `largest_scale`]."""
        if not 1 < scale <= self.largest_scale:
            raise ValueError(f"scales lie above 1 and up to {self.largest_scale}, not at {scale}")
        return np.array([index * scale.numerator // scale.denominator for index in range(self.num_kept)])

    def span_frames(self, scale: Fraction) -> int:
        """⌊(N − 1)·s⌋ + 1: the requested frames, from the first given one to the last."""
        return (self.num_kept - 1) * scale.numerator // scale.denominator + 1

    def synthesised(self, scale: Fraction) -> Bool[np.ndarray, "span"]:
        """Mask of the frames of the span that are not given."""
        marks = np.ones(self.span_frames(scale), dtype=bool)
        marks[self.kept_frames(scale)] = False
        return marks


def scale_label(scale: Fraction) -> str:
    """×2, ×2.4."""
    return f"×{float(scale):g}"
