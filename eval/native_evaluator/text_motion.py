"""The native-rate evaluator on whole motions, as a `TextMotionEvaluator`."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from eval.native_evaluator.evaluator import NativeEvaluator
from eval.native_evaluator.network import MIN_POSES
from eval.sets.sets import SampleSet
from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import SMPL22


@dataclass(frozen=True, eq=False)
class NativeTextMotion:
    """Embeddings of whole motions and sentences in the shared space.

    The evaluator was trained on clips of at most 64 poses; its GRU and its mean over time extend to longer motions.
    """

    evaluator: NativeEvaluator

    @property
    def name(self) -> str:
        """Name for tables."""
        return self.evaluator.name

    @property
    def fingerprint(self) -> str:
        """The evaluator's fingerprint, marked as that of whole motions."""
        return f"{self.evaluator.fingerprint}-whole"

    @property
    def fps(self) -> Fraction | None:
        """None: any framerate is accepted."""
        return None

    @property
    def layout(self) -> str:
        """The 22 joints that it was trained with."""
        return SMPL22.name

    def remark_at(self, fps: Fraction) -> str:
        """A remark if it was not trained at this framerate, else empty."""
        return self.evaluator.remark_at(fps)

    def embed_motions(self, samples: SampleSet) -> Float64[np.ndarray, "sequences features"]:
        """One row per sequence, in the order of the set; sequences of one length form a batch.

        Raises `MotionkitError` if one has fewer than 8 poses.
        """
        shortest = int(samples.sequences.num_frames.min())
        if shortest < MIN_POSES:
            name = samples.sequence_ids[int(samples.sequences.num_frames.argmin())]
            raise MotionkitError(
                f"{samples.name}: {name!r} has {shortest} poses at {samples.fps} fps, the native evaluator needs at "
                f"least {MIN_POSES}; leave such motions out"
            )
        rows: dict[int, npt.NDArray[np.float64]] = {}
        for length in np.unique(samples.sequences.num_frames).tolist():
            members = np.flatnonzero(samples.sequences.num_frames == length).tolist()
            clips = np.stack([samples.sequences[index] for index in members])
            rows.update(zip(members, self.evaluator.embed_motions(clips, samples.fps), strict=True))
        return np.stack([rows[index] for index in range(samples.num_sequences)])

    def embed_texts(self, captions: Sequence[Caption]) -> Float64[np.ndarray, "texts features"]:
        """One row per caption, in order. Raises `MotionkitError` if it was trained without captions."""
        return self.evaluator.embed_texts([caption.text for caption in captions])
