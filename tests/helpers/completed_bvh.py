"""A BVH document completed, and written with its own lines and channels."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.fields.completion import begin_completion
from motionkit.fields.motion_field import MotionEncoder, Observation
from motionkit.fields.rig import on_bones
from motionkit.io.bvh import BvhDocument, KnownFrames, rewrite_bvh


def write_completed(
    document: BvhDocument,
    observed: np.ndarray,
    encoder: MotionEncoder,
    fps: Fraction,
    path: Path,
    **reach: float,
) -> None:
    """Complete the observed frames of a document at a framerate, and write the result."""
    seconds, frames = document.motion.timegrid.seconds(), np.flatnonzero(observed)
    observation = Observation(seconds[frames], document.poses.rows(frames), document.motion.skeleton)
    made = begin_completion(observation, (seconds[0], seconds[-1]), encoder, fps, **reach)
    made = replace(made, field=on_bones(made.field, observation))
    known = KnownFrames(frames, seconds[frames], made.given_rows, frames[made.given_poses])
    rewrite_bvh(document, path, made.motion(), known)
