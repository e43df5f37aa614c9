"""How far a motion field is from observed poses."""

import numpy as np

from motionkit.fields.motion_field import MotionField, Observation


def observed_errors(field: MotionField, observation: Observation) -> np.ndarray:
    """Distances of a field's joints from the observed ones at the observed times, metres [frames, joints]."""
    positions = field.query(observation.times_seconds).joint_positions.astype(np.float64)
    return np.linalg.norm(positions - observation.poses.joint_positions, axis=-1)
