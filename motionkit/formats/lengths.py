"""A motion in another unit of length."""

from dataclasses import replace

import numpy as np

from motionkit.motion import Motion
from motionkit.skeleton import STANDARD_SKELETONS


def in_metres(motion: Motion, unit_metres: float | None) -> Motion:
    """Every length of a motion and its skeleton times `unit_metres`, logged; None or 1 leaves it as it is.

    A standard skeleton, which stands for one that the file does not describe, is in metres already.
    """
    if unit_metres is None or unit_metres == 1.0:
        return motion
    factor = np.float32(unit_metres)
    standard = motion.skeleton in STANDARD_SKELETONS.values()
    scaled = replace(
        motion,
        joint_positions=motion.joint_positions * factor,
        root_translation=None if motion.root_translation is None else motion.root_translation * factor,
        skeleton=motion.skeleton if standard else motion.skeleton.scaled(unit_metres),
    )
    return scaled.logged(f"lengths × {unit_metres:g} to metres (given)")
