"""A fixed description of a motion by which actions can be told apart: poses, path and turning, as statistics over time.

Positions are relative to the root and turned to one heading at every instant; the path is told by its speed forwards,
sidewards and upwards, and by how fast the body turns. So where a motion stands and which way it faces changes nothing.
"""

import numpy as np
from jaxtyping import Float32, Float64

from eval.evaluators.kinematic import local_poses
from motionkit.skeleton import SMPL22

VERSION = "motion-statistics/1"
MIN_FRAMES = 10
LONGEST_SECONDS = 3
QUANTILES = (0.1, 0.9)
LEFT_HIP, RIGHT_HIP, LEFT_SHOULDER, RIGHT_SHOULDER = (
    SMPL22.index(name) for name in ("left_hip", "right_hip", "left_shoulder", "right_shoulder")
)
FEET = tuple(SMPL22.index(name) for name in ("left_ankle", "left_foot", "right_ankle", "right_foot"))


def motion_statistics(positions: Float32[np.ndarray, "frames 22 3"], fps: float) -> Float64[np.ndarray, "numbers"]:
    """Mean, spread, quantiles and speed of every coordinate, and mean and spread of how the root moves (325 numbers).

    `positions` in metres, y up. Raises `ValueError` for fewer than 10 frames.
    """
    if len(positions) < MIN_FRAMES:
        raise ValueError(f"{len(positions)} frames; statistics of a motion need at least {MIN_FRAMES}")
    wide = positions.astype(np.float64)
    poses = local_poses(wide[None])[0]
    root = _root_motion(wide, fps)
    height = wide[:, 0, 1] - wide[:, list(FEET), 1].min()
    return np.concatenate(
        (
            poses.mean(axis=0),
            poses.std(axis=0),
            np.quantile(poses, QUANTILES, axis=0).reshape(-1),
            root.mean(axis=0),
            root.std(axis=0),
            (height.mean(), height.std()),
            np.abs(np.diff(poses, axis=0)).mean(axis=0) * fps,
        )
    )


def _root_motion(positions: Float64[np.ndarray, "frames 22 3"], fps: float) -> Float64[np.ndarray, "steps 4"]:
    """Velocity to the left, forwards and upwards (m/s), and turning (rad/s), step by step."""
    across = (
        positions[:, LEFT_HIP] - positions[:, RIGHT_HIP] + positions[:, LEFT_SHOULDER] - positions[:, RIGHT_SHOULDER]
    )
    heading = np.unwrap(np.arctan2(-across[:, 2], across[:, 0]))
    velocity = np.diff(positions[:, 0], axis=0) * fps
    left = np.stack((np.cos(heading[:-1]), -np.sin(heading[:-1])), axis=1)
    forwards = np.stack((np.sin(heading[:-1]), np.cos(heading[:-1])), axis=1)
    horizontal = velocity[:, [0, 2]]
    return np.stack(
        ((horizontal * left).sum(1), (horizontal * forwards).sum(1), velocity[:, 1], np.diff(heading) * fps), axis=1
    )
