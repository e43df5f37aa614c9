"""Interpolation at any scale: which real frames are given and which are asked for (PA-HiRes, Tables 1 and 2).

The paper says neither how PSNR is taken of motion nor which frames a scale of 2.4 keeps; this is motionkit's own
definition (docs/metrics.md), with a version.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from jaxtyping import Bool, Int64

VERSION = "interpolation/1"
INTEGER_SCALES = tuple(Fraction(scale) for scale in (2, 3, 4, 5))
OTHER_SCALES = tuple(Fraction(scale) for scale in ("1.2", "2.4", "3.6", "4.8"))


@dataclass(frozen=True)
class InterpolationProtocol:
    """Clips of `num_kept` given frames; at scale s frame ⌊i·s⌋ is the i-th given one, at its true time.

    Clips start at every multiple of the span of the largest scale, `clip_frames`, so that every scale of both tables
    sees the same places of the same takes, and what is given of them is always as many frames.
    """

    num_kept: int = 16
    largest_scale: Fraction = Fraction(5)

    @property
    def clip_frames(self) -> int:
        """Frames from one clip's start to the next one's: those that the largest scale spans."""
        return self.span_frames(self.largest_scale)

    def kept_frames(self, scale: Fraction) -> Int64[np.ndarray, "kept"]:
        """⌊i·s⌋ for i = 0 … N − 1, exactly; scales below 1 raise `ValueError`, for they would keep a frame twice."""
        if not 1 < scale <= self.largest_scale:
            raise ValueError(f"scales lie above 1 and up to {self.largest_scale}, not at {scale}")
        return np.array([index * scale.numerator // scale.denominator for index in range(self.num_kept)])

    def span_frames(self, scale: Fraction) -> int:
        """⌊(N − 1)·s⌋ + 1: the frames from the first given one to the last, all of which are asked for."""
        return (self.num_kept - 1) * scale.numerator // scale.denominator + 1

    def synthesised(self, scale: Fraction) -> Bool[np.ndarray, "span"]:
        """Which frames of the span are not given."""
        marks = np.ones(self.span_frames(scale), dtype=bool)
        marks[self.kept_frames(scale)] = False
        return marks


def scale_label(scale: Fraction) -> str:
    """×2, ×2.4."""
    return f"×{float(scale):g}"
