"""A motion in another unit of length."""

from dataclasses import replace

import numpy as np

from motionkit.motion import Motion


def in_metres(motion: Motion, unit_metres: float | None) -> Motion:
    """Every length of a motion and its skeleton times `unit_metres`, logged; None or 1 leaves it as it is."""
    if unit_metres is None or unit_metres == 1.0:
        return motion
    factor, skeleton = np.float32(unit_metres), motion.skeleton
    scaled = replace(
        motion,
        joint_positions=motion.joint_positions * factor,
        root_translation=None if motion.root_translation is None else motion.root_translation * factor,
        skeleton=replace(
            skeleton,
            offsets=skeleton.offsets * factor,
            end_sites=tuple(
                (joint, (x * unit_metres, y * unit_metres, z * unit_metres)) for joint, (x, y, z) in skeleton.end_sites
            ),
        ),
    )
    return scaled.logged(f"lengths × {unit_metres:g} to metres (given)")
