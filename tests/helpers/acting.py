"""Motions that act: a body that nods or shuffles, with noise, somewhere, facing anywhere."""

import numpy as np

from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions

ACTIONS = ("nod", "shuffle left", "shuffle right")


def acted_at(seconds: np.ndarray, action: str, seed: int) -> np.ndarray:
    """Joint positions [times, 22, 3] in metres; the same at an instant, whatever the others are."""
    rng = np.random.default_rng(seed)
    time = seconds[:, None]
    rate, phase = rng.uniform(0.2, 1.0, (22, 3)), rng.uniform(0, 6, (22, 3))
    body = rest_positions(SMPL22) + 0.01 * np.sin(2 * np.pi * rate * time[..., None] + phase)
    if action == "nod":
        body[:, [12, 15], 2] += 0.1 * np.sin(2 * np.pi * rng.uniform(0.8, 1.2) * time)
    else:
        body[:, :, 0] += (0.4 if action == "shuffle left" else -0.4) * time
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return (body @ turn.T + np.array([rng.normal(), 0.9, rng.normal()])).astype(np.float32)


def acted(action: str, seed: int, num_frames: int = 50, fps: float = 20.0) -> np.ndarray:
    """A motion of whole frames."""
    return acted_at(np.arange(num_frames) / fps, action, seed)
