"""The slices that `humanml3d` and `native` compute alike: root height, joint positions, joint velocities."""

import numpy as np
from jaxtyping import Float32

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
    cosine: Float32[np.ndarray, "rows"],
    sine: Float32[np.ndarray, "rows"],
    part: VectorLayout,
) -> None:
    """Write root height and root-relative joint positions, turned by the angle that brings each pose to Z+."""
    num_rows = joints.shape[2]
    rows[part.root_height] = joints[1, 0]
    relative = rows[part.joint_positions].reshape(part.num_joints - 1, 3, num_rows)
    x, z = joints[0, 1:] - joints[0, 0], joints[2, 1:] - joints[2, 0]
    np.add(cosine * x, sine * z, out=relative[:, 0])
    relative[:, 1] = joints[1, 1:]
    np.subtract(cosine * z, sine * x, out=relative[:, 2])


def fill_joint_velocities(
    rows: Float32[np.ndarray, "numbers rows"],
    change: Float32[np.ndarray, "3 joints rows"],
    cosine: Float32[np.ndarray, "rows"],
    sine: Float32[np.ndarray, "rows"],
    part: VectorLayout,
) -> None:
    """Write the joints' displacements or velocities, turned with the body."""
    velocities = rows[part.joint_velocities].reshape(part.num_joints, 3, change.shape[2])
    turn(change, cosine, sine, out=velocities[:, ::2].transpose(1, 0, 2))
    velocities[:, 1] = change[1]
