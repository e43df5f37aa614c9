"""A BVH document completed, and written with its own lines and channels."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.edit.motions import EditedMotion, LoadedMotion, write_edited
from motionkit.fields.completion import begin_completion
from motionkit.fields.motion_field import MotionEncoder
from motionkit.fields.rig import on_bones
from motionkit.io.bvh import BvhDocument


def write_completed(
    document: BvhDocument,
    observed: np.ndarray,
    encoder: MotionEncoder,
    fps: Fraction,
    path: Path,
    **reach: float,
) -> None:
    """Complete the observed frames of a document at a framerate, and write the result."""
    loaded = LoadedMotion(document.motion, document.valid, document=document, suffix=".bvh")
    observation, seconds = loaded.observation(observed), document.motion.timegrid.seconds()
    made = begin_completion(observation, (seconds[0], seconds[-1]), encoder, fps, **reach)
    made = replace(made, field=on_bones(made.field, observation))
    given = np.flatnonzero(observed)[made.given_poses]
    write_edited(EditedMotion(made.motion(), observed, made.given_rows, given), loaded, path)
