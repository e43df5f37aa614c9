from fractions import Fraction

import numpy as np

import motionkit as mk
from motionkit.fields.motion_field import MotionEncoder, Observation
from motionkit.fields.resample import begin_completion


def complete(
    motion: mk.Motion,
    encoder: MotionEncoder,
    *,
    fps: Fraction | None = None,
    observed: np.ndarray | None = None,
    before_seconds: float = 0.0,
    after_seconds: float = 0.0,
) -> mk.Motion:
    """A motion completed by an encoder from its observed frames, by default all."""
    start = motion.timegrid.start_seconds
    span = (start, start + motion.timegrid.span_seconds)
    reach = {"before_seconds": before_seconds, "after_seconds": after_seconds}
    completion = begin_completion(Observation.of(motion, observed), span, encoder, fps or motion.fps, **reach)
    return completion.motion().annotated_like(motion)
