"""The slices that `humanml3d` and `native` compute alike: root height, joint positions, joint velocities."""

import numpy as np
from jaxtyping import Float32, Float64

from motionkit.features.layout import VectorLayout


def turn(
    vectors: Float32[np.ndarray, "3 *rest"],
    cosine: Float32[np.ndarray, "rows"],
    sine: Float32[np.ndarray, "rows"],
    out: Float32[np.ndarray, "2 *rest"],
) -> None:
    """Write the x and z of vectors [x, y, z] turned about Y by the angle of the given cosine and sine."""
    np.add(cosine * vectors[0], sine * vectors[2], out=out[0])
    np.subtract(cosine * vectors[2], sine * vectors[0], out=out[1])


def fill_positions(
    rows: Float32[np.ndarray, "numbers rows"],
    joints: Float32[np.ndarray, "3 joints rows"],
    half_angle: Float64[np.ndarray, "rows"],
    part: VectorLayout,
) -> None:
    """Write root height and root-relative joint positions; `half_angle` turns each pose to Z+."""
    cosine, sine = np.cos(2 * half_angle).astype(np.float32), np.sin(2 * half_angle).astype(np.float32)
    num_rows = joints.shape[2]
    rows[part.root_height] = joints[1, 0]
    relative = rows[part.joint_positions].reshape(part.num_joints - 1, 3, num_rows)
    turn(joints[:, 1:] - joints[:, :1], cosine, sine, out=relative[:, ::2].transpose(1, 0, 2))
    relative[:, 1] = joints[1, 1:]


def fill_joint_velocities(
    rows: Float32[np.ndarray, "numbers rows"],
    change: Float32[np.ndarray, "3 joints rows"],
    half_angle: Float64[np.ndarray, "rows"],
    part: VectorLayout,
) -> None:
    """Write the joints' displacements or velocities, turned with the body."""
    cosine, sine = np.cos(2 * half_angle).astype(np.float32), np.sin(2 * half_angle).astype(np.float32)
    velocities = rows[part.joint_velocities].reshape(part.num_joints, 3, change.shape[2])
    turn(change, cosine, sine, out=velocities[:, ::2].transpose(1, 0, 2))
    velocities[:, 1] = change[1]
