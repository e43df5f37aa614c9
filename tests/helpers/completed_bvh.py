"""A BVH document completed, and written with its own lines and channels."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.edit.motions import EditedMotion, LoadedMotion, write_edited
from motionkit.fields.completion import begin_observed
from motionkit.fields.motion_field import MotionEncoder
from motionkit.fields.rig import on_bones
from motionkit.io.bvh.document import BvhDocument


def write_completed(
    document: BvhDocument,
    observed: np.ndarray,
    encoder: MotionEncoder,
    fps: Fraction,
    path: Path,
    **reach: float,
) -> None:
    """Complete the observed frames of a document at a framerate, and write the result."""
    loaded = LoadedMotion(document.motion(), document.seen, document=document, suffix=".bvh")
    observation, known = loaded.observation(observed), np.flatnonzero(observed)
    made = begin_observed(observation, known, document.timegrid, encoder, fps, **reach)
    made = replace(made, field=on_bones(made.field, observation))
    motion = made.motion(0, made.grid.num_frames)
    write_edited(EditedMotion(motion, observed, made.given_rows, known[made.given_poses]), loaded, path)
