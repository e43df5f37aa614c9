"""What clip-FID needs of a feature extractor, learned or not."""

from fractions import Fraction
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float64


@runtime_checkable
class FeatureSet(Protocol):
    """Turns clips of one framerate into feature vectors; the same clips give the same numbers in any batch."""

    @property
    def name(self) -> str:
        """Name for tables."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash of everything that the numbers depend on: definition, weights, statistics."""
        ...

    def describe(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """One row per clip, in order; positions in metres, y up, the 22 joints of `SMPL22`."""
        ...
