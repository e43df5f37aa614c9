"""A set known at a low framerate, brought to a high one as pose vectors: the handicap of published baselines, maybe."""

from fractions import Fraction

import numpy as np
from jaxtyping import Float32

from eval.samples.sets import SampleSet
from motionkit.features import humanml3d
from motionkit.features.humanml3d_processing import at_origin, facing_forward, on_floor
from motionkit.skeleton import SMPL22


def upsample_as_vectors(samples: SampleSet, fps: Fraction, name: str) -> SampleSet:
    """HumanML3D vectors interpolated linearly, their per-frame root velocities left as they are, then recovered.

    The root's path and turns grow by the upsampling factor: a handicap of the procedure, not of the motion. It would
    explain how published baselines grow with the framerate, and is shown beside the fair way for that reason only.
    """
    if fps < samples.fps:
        raise ValueError(f"{samples.name} is at {samples.fps} fps, which is more than {fps}")
    made = [_through_vectors(sequence, samples.fps, fps) for sequence in samples.sequences()]
    return samples.with_positions(name, fps, made)


def _through_vectors(
    positions: Float32[np.ndarray, "frames joints 3"], fps_from: Fraction, fps_to: Fraction
) -> Float32[np.ndarray, "new_frames joints 3"]:
    placed = facing_forward(at_origin(on_floor(positions)), SMPL22.name)
    vectors = humanml3d.vectors(placed, SMPL22.name)
    ratio = float(fps_from / fps_to)
    num_rows = int((len(vectors) - 1) * (fps_to / fps_from)) + 1
    place = np.arange(num_rows) * ratio
    below = np.minimum(place.astype(np.int64), len(vectors) - 1)
    above = np.minimum(below + 1, len(vectors) - 1)
    fraction = (place - below)[:, None]
    mixed = (1.0 - fraction) * vectors[below] + fraction * vectors[above]
    return humanml3d.positions(mixed.astype(np.float32), SMPL22.name)
