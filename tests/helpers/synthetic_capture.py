"""Captures of synthetic bodies, clean or noisy."""

from dataclasses import replace
from fractions import Fraction

import numpy as np

from motionkit.core.motion import Motion
from motionkit.fields.motion_field import to_motion
from motionkit.synthetic import draw_body, perform


def capture(fps: Fraction, action: str = "walk", seconds: float = 6.0, noise: float = 0.0, seed: int = 0) -> Motion:
    rng = np.random.default_rng([seed, 5])
    motion = to_motion(perform(rng, draw_body(rng, "somebody"), [action], seconds), fps)
    shaken = motion.joint_positions + noise * rng.standard_normal(motion.joint_positions.shape)
    return replace(motion, joint_positions=shaken.astype(np.float32))
