"""A recogniser of actions: what it is given, and what it answers."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.sets.sets import SampleSet
from motionkit.core.errors import MotionkitError
from motionkit.core.shapes import Float64

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
