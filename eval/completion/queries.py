"""Poses of many motions at once by any motion encoder."""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from motionkit.core.shapes import Float64
from motionkit.fields.motion_field import BatchEncoder, MotionEncoder, Observation, Poses, at_fps, check_observed_alike


def query_many(
    encoder: MotionEncoder,
    observations: Sequence[Observation],
    times_seconds: Float64[np.ndarray, "times"],
    fps: Fraction,
) -> list[Poses]:
    """Evaluates the fields of many motions, observed at the same times: batched if the encoder can.

    Times may lie beyond the observed span; fields that depend on the framerate get `fps`. Raises `ValueError` for
    motions that are observed at different times or differ in their joints, and where the encoder cannot go that far.
    """
    check_observed_alike(observations)
    if isinstance(encoder, BatchEncoder):
        return encoder.query_many(observations, times_seconds)
    before = max(0.0, observations[0].start_seconds - float(times_seconds.min()))
    after = max(0.0, float(times_seconds.max()) - observations[0].end_seconds)
    fields = (encoder.encode(observation, before_seconds=before, after_seconds=after) for observation in observations)
    return [at_fps(field, fps).query(times_seconds) for field in fields]
