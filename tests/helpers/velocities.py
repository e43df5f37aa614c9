"""Velocities of a motion field's joints by finite differences, and how far they are from observed poses."""

import numpy as np

from motionkit.fields.motion_field import MotionField, Observation


def joint_velocities(field: MotionField, times_seconds: np.ndarray, *, step_seconds: float = 1e-3) -> np.ndarray:
    """m/s [times, joints, 3]: the slope at each time of the parabola through three poses one step apart.

    The three lie around the time, or inside the domain where it is near an end. Poses are float32, so a step of 1 ms
    resolves about 0.1 mm/s.
    """
    step = min(step_seconds, (field.end_seconds - field.start_seconds) / 2)
    centre = np.clip(times_seconds, field.start_seconds + step, field.end_seconds - step)
    three = np.concatenate((centre - step, centre, centre + step))
    poses = field.query(np.clip(three, field.start_seconds, field.end_seconds)).joint_positions.astype(np.float64)
    before, here, after = np.split(poses, 3)
    offset = (times_seconds - centre)[:, None, None]
    return (after - before) / (2 * step) + offset * (before - 2 * here + after) / step**2


def observed_errors(field: MotionField, observation: Observation) -> np.ndarray:
    """Distances of a field's joints from the observed ones at the observed times, metres [frames, joints]."""
    positions = field.query(observation.times_seconds).joint_positions.astype(np.float64)
    return np.linalg.norm(positions - observation.poses.joint_positions, axis=-1)
