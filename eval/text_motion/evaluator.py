"""Interface of text-motion evaluators for R-Precision, MultiModal Dist and the FID of whole motions."""

from collections.abc import Sequence
from fractions import Fraction
from typing import Protocol, runtime_checkable

import numpy as np

from eval.sets.sets import SampleSet
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float32, Float64


@runtime_checkable
class TextMotionEvaluator(Protocol):
    """Embeds whole motions and sentences in one space; distances there are Euclidean.

    A motion's row depends on that motion alone, not on its batch.
    """

    @property
    def name(self) -> str:
        """Name for tables."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash of everything that the embeddings depend on: definition, weights, statistics, settings."""
        ...

    @property
    def fps(self) -> Fraction | None:
        """The required framerate of the motions; None if any is accepted."""
        ...

    @property
    def layout(self) -> str:
        """Joint layout of the motions that it reads: `smpl22` or `kit21`."""
        ...

    @property
    def pair_score(self) -> str:
        """Name, in `eval.metrics.metric`, of the score of pairs of unit vectors that its authors report; or empty."""
        ...

    def remark_at(self, fps: Fraction) -> str:
        """The remark of a table on its numbers at a framerate; may be empty."""
        ...

    def embed_motions(self, samples: SampleSet) -> Float64[np.ndarray, "sequences features"]:
        """One row per sequence, in the order of the set. Raises `MotionkitError` for another framerate."""
        ...

    def embed_texts(self, captions: Sequence[Caption]) -> Float64[np.ndarray, "texts features"]:
        """One row per caption, in order. Raises `MotionkitError` if one cannot be read."""
        ...


@runtime_checkable
class PoseVectorEvaluator(TextMotionEvaluator, Protocol):
    """An evaluator of pose vectors, which are passed unchanged, as in published comparisons."""

    @property
    def vector_size(self) -> int:
        """Numbers of the pose vectors that it reads."""
        ...

    def embed_vectors(
        self, motions: Sequence[Float32[np.ndarray, "_frames numbers"]], lengths: Sequence[int] | None = None
    ) -> Float64[np.ndarray, "motions features"]:
        """One row per motion given as pose vectors in their own units; frames past `lengths` are not read.

        Raises `MotionkitError` for invalid pose vectors.
        """
        ...
