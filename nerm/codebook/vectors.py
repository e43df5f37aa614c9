"""The pose vectors that the codebook is learnt from: heading-relative, per second, functions of joint positions.

For J joints 6·J + 1 numbers, 133 for 22: yaw rate (rad/s), root velocity to the body's left and front (m/s), root
height (m), joints 1 … J − 1 relative to the root's ground point and facing Z+ (m, HumanML3D's "RIC" block), velocities
of all joints in the same axes (m/s). The published vector's rotations and contacts are left out: both are functions of
positions (swing-only inverse kinematics, a threshold on speed).
"""

from fractions import Fraction

import numpy as np
from jaxtyping import Float, Float32

from motionkit.features import field


def joint_positions_block(num_joints: int) -> slice:
    """Where the joints' positions lie in a vector (the RIC block)."""
    return slice(4, 4 + 3 * (num_joints - 1))


def codebook_vectors(
    joint_positions: Float[np.ndarray, "frames joints 3"], fps: Fraction
) -> Float32[np.ndarray, "rows numbers"]:
    """T − 1 vectors of T poses in metres; raises `ValueError` for fewer than two poses."""
    if len(joint_positions) < 2:
        raise ValueError("pose vectors need two poses or more")
    yaw = np.unwrap(field.heading(joint_positions).astype(np.float64))
    rate = float(fps)
    here, facing = joint_positions[:-1], yaw[:-1]
    turned = field.to_window(here[:, None], facing, here[:, 0, (0, 2)])[:, 0]
    velocities = (
        field.to_window(np.diff(joint_positions, axis=0)[:, None], facing, np.zeros((len(here), 2)))[:, 0] * rate
    )
    parts = (
        (np.diff(yaw) * rate)[:, None],
        velocities[:, 0, (0, 2)],
        turned[:, 0, 1:2],
        turned[:, 1:].reshape(len(here), -1),
        velocities.reshape(len(here), -1),
    )
    return np.concatenate(parts, axis=1).astype(np.float32)
