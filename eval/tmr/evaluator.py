"""A trained TMR-style evaluator: unit vectors of whole motions and sentences, matched by their cosine."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from eval.native_evaluator.evaluator import load_networks
from eval.native_evaluator.text_motion import NativeTextMotion
from eval.sets.sets import SampleSet
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float64

VERSION = "tmr/1"
STAGE_NAME = "tmr"


@dataclass(frozen=True, eq=False)
class TmrEvaluator:
    """The networks on whole motions; embeddings have length 1, so Euclidean distances and cosines rank alike."""

    motions: NativeTextMotion

    @property
    def name(self) -> str:
        """Name for tables."""
        return "tmr"

    @property
    def pair_score(self) -> str:
        """The score of pairs that TMR and Kimodo report."""
        return "tmr_score"

    @property
    def fingerprint(self) -> str:
        """Hash of version, settings, weights and statistics."""
        return self.motions.fingerprint

    @property
    def fps(self) -> Fraction | None:
        """None: any framerate is accepted."""
        return None

    @property
    def layout(self) -> str:
        """The 22 joints that it was trained with."""
        return self.motions.layout

    def remark_at(self, fps: Fraction) -> str:
        """A remark if it was not trained at this framerate, else empty."""
        return self.motions.evaluator.remark_as(self.name, STAGE_NAME, fps)

    def embed_motions(self, samples: SampleSet) -> Float64[np.ndarray, "sequences features"]:
        """One row per sequence, in the order of the set; raises as `NativeTextMotion.embed_motions`."""
        return _unit(self.motions.embed_motions(samples))

    def embed_texts(self, captions: Sequence[Caption]) -> Float64[np.ndarray, "texts features"]:
        """One row per caption, in order; raises as `NativeTextMotion.embed_texts`."""
        return _unit(self.motions.embed_texts(captions))


def _unit(rows: Float64[np.ndarray, "rows features"]) -> Float64[np.ndarray, "rows features"]:
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12))


def load_tmr(run: Path) -> TmrEvaluator:
    """Load the evaluator from a run folder (`motionkit train --stage tmr`).

    Raises `RunError` if its training is not finished and `CheckpointError` if the file is of another version.
    """
    return TmrEvaluator(NativeTextMotion(load_networks(run, STAGE_NAME, VERSION)))
