"""Reconstruction errors of poses: positions, angles, pose vectors in raw units, bones, derivatives.

Arrays hold valid frames only, of one sequence or of many concatenated; every frame has the same weight.
"""

import numpy as np

from eval.metrics.checks import checked_difference, checked_features, checked_fps, checked_quaternions
from eval.metrics.metric import Metric, by_clip_steps, by_frames, by_numbers
from motionkit.core.shapes import Float, Float64


def mpjpe_global(
    predicted: Float[np.ndarray, "frames joints 3"], target: Float[np.ndarray, "frames joints 3"]
) -> float:
    """Mean distance between predicted and true joints in metres, in global coordinates."""
    difference = checked_difference(predicted, target)
    return float(np.linalg.norm(difference, axis=-1).mean())


MPJPE_GLOBAL = Metric(
    "mpjpe_global", "MPJPE (global)", "m", False, "Ionescu et al. 2014", "predicted, target", mpjpe_global, by_frames
)


def mpjpe_root_aligned(
    predicted: Float[np.ndarray, "frames joints 3"], target: Float[np.ndarray, "frames joints 3"], root: int = 0
) -> float:
    """Mean distance in metres with every frame's root aligned to the true one (the root itself is included, as 0).

    This is what motion-latent-diffusion and the NeRM paper's Table 4 call MPJPE.
    """
    difference = checked_difference(predicted, target)
    difference -= difference[:, root : root + 1].copy()
    return float(np.linalg.norm(difference, axis=-1).mean())


MPJPE = Metric(
    "mpjpe",
    "MPJPE",
    "m",
    False,
    "motion-latent-diffusion; NeRM Table 4",
    "predicted, target",
    mpjpe_root_aligned,
    by_frames,
)


def mpjpe_procrustes(
    predicted: Float[np.ndarray, "frames joints 3"], target: Float[np.ndarray, "frames joints 3"]
) -> float:
    """Mean distance in metres after aligning rotation, translation and scale of every frame (PA-MPJPE; Gower 1975)."""
    checked_difference(predicted, target)
    x, y = predicted.astype(np.float64), target.astype(np.float64)
    x -= x.mean(axis=1, keepdims=True)
    y -= y.mean(axis=1, keepdims=True)
    u, singular, vt = np.linalg.svd(np.swapaxes(x, 1, 2) @ y)
    signs = np.ones_like(singular)
    signs[:, 2] = np.sign(np.linalg.det(u @ vt))
    rotation = (u * signs[:, None]) @ vt
    size = np.einsum("fji,fji->f", x, x)
    scale = np.where(size > 0, (singular * signs).sum(axis=1) / np.where(size > 0, size, 1.0), 1.0)
    return float(np.linalg.norm(scale[:, None, None] * (x @ rotation) - y, axis=-1).mean())


MPJPE_PROCRUSTES = Metric(
    "mpjpe_procrustes", "MPJPE (Procrustes)", "m", False, "Gower 1975", "predicted, target", mpjpe_procrustes, by_frames
)


def rotation_angle_error(
    predicted: Float[np.ndarray, "frames joints 4"], target: Float[np.ndarray, "frames joints 4"]
) -> float:
    """Mean geodesic distance in degrees between predicted and true joint rotations.

    Unit quaternions of either sign, local or global on both sides. Raises `ValueError` for others.
    """
    checked_difference(predicted, target)
    checked_quaternions(predicted, target)
    p, q = predicted.astype(np.float64), target.astype(np.float64)
    # ‖p − q‖ and ‖p + q‖ are 2·sin and 2·cos of a quarter of the angle: exact for small angles, where arccos is not.
    apart, together = np.linalg.norm(p - q, axis=-1), np.linalg.norm(p + q, axis=-1)
    quarter = np.arctan2(np.minimum(apart, together), np.maximum(apart, together))
    return float(np.degrees(4.0 * quarter).mean())


ROTATION_ERROR = Metric(
    "rotation_angle_error",
    "Rotation error",
    "°",
    False,
    "geodesic distance on SO(3)",
    "predicted, target",
    rotation_angle_error,
    by_frames,
)


def mre(predicted: Float[np.ndarray, "frames numbers"], target: Float[np.ndarray, "frames numbers"]) -> float:
    """Root-mean-square difference over all numbers of the redundant pose vectors, in their raw units.

    The NeRM paper defines MRE as the Euclidean distance between two pose vectors, but its 0.041 beside an MPJPE of
    0.016 cannot be that norm; `mean_vector_distance` is the literal definition.
    """
    difference = checked_difference(predicted, target)
    return float(np.sqrt(np.mean(difference * difference)))


MRE = Metric(
    "mre", "MRE", "raw", False, "NeRM Table 4, as a root mean square", "predicted, target", mre, by_numbers, exponent=2
)


def mean_vector_distance(
    predicted: Float[np.ndarray, "frames numbers"], target: Float[np.ndarray, "frames numbers"]
) -> float:
    """Mean Euclidean distance between pose vectors: MRE as the paper describes it (L2 norm, raw units)."""
    return float(np.linalg.norm(checked_difference(predicted, target), axis=-1).mean())


MEAN_VECTOR_DISTANCE = Metric(
    "mean_vector_distance",
    "MRE (L2 norm)",
    "raw",
    False,
    "NeRM Table 4",
    "predicted, target",
    mean_vector_distance,
    by_frames,
)


def bone_length_variation(positions: Float[np.ndarray, "frames joints 3"], parents: tuple[int, ...]) -> float:
    """Mean over bones of (standard deviation over frames ÷ mean length), ddof 0, of one sequence; 0 for a rigid body.

    `parents` are indices of parent joints, −1 for the root. Bones of length zero (joints on their parent in every
    frame) are ignored. Raises `ValueError` if no bone is left, for NaN or infinity. Defined here.
    """
    lengths = _lengths(positions, parents)
    mean = lengths.mean(axis=0)
    if not (mean > 0).any():
        raise ValueError("all joints lie on their parents: there is no bone to measure")
    return float((lengths.std(axis=0)[mean > 0] / mean[mean > 0]).mean())


BONE_LENGTH_VARIATION = Metric(
    "bone_length_variation",
    "Bone-length variation",
    "",
    False,
    "motionkit",
    "one set",
    bone_length_variation,
    by_frames,
)


def bone_length_error(
    predicted: Float[np.ndarray, "frames joints 3"],
    target: Float[np.ndarray, "frames joints 3"],
    parents: tuple[int, ...],
) -> float:
    """Mean absolute difference of predicted and true bone lengths over frames and bones, metres. Defined here."""
    if predicted.shape != target.shape:
        raise ValueError(f"predicted is {predicted.shape}, target is {target.shape}; they must agree")
    return float(np.abs(_lengths(predicted, parents) - _lengths(target, parents)).mean())


BONE_LENGTH_ERROR = Metric(
    "bone_length_error", "Bone-length error", "m", False, "motionkit", "predicted, target", bone_length_error, by_frames
)


def _lengths(
    positions: Float[np.ndarray, "frames joints 3"], parents: tuple[int, ...]
) -> Float64[np.ndarray, "frames bones"]:
    if len(parents) != positions.shape[1]:
        raise ValueError(f"there are {positions.shape[1]} joints and {len(parents)} parents")
    joints = np.array([joint for joint, parent in enumerate(parents) if parent >= 0], dtype=np.int64)
    if not joints.size:
        raise ValueError("a skeleton of roots alone has no bones")
    values = checked_features(positions.reshape(len(positions), -1), "positions", minimum=1).reshape(positions.shape)
    return np.asarray(np.linalg.norm(values[:, joints] - values[:, np.array(parents)[joints]], axis=-1))


def velocity_error(
    predicted: Float[np.ndarray, "*clips frames joints 3"],
    target: Float[np.ndarray, "*clips frames joints 3"],
    fps: float,
) -> float:
    """Mean distance between predicted and true joint velocities, m/s."""
    return _derivative_error(predicted, target, fps, order=1)


VELOCITY_ERROR = Metric(
    "velocity_error",
    "Velocity error",
    "m/s",
    False,
    "mean joint distance of differences",
    "predicted, target, fps",
    velocity_error,
    by_clip_steps(1),
)


def acceleration_error(
    predicted: Float[np.ndarray, "*clips frames joints 3"],
    target: Float[np.ndarray, "*clips frames joints 3"],
    fps: float,
) -> float:
    """Mean distance between predicted and true joint accelerations, m/s² ("Accel": Kanazawa et al. 2019)."""
    return _derivative_error(predicted, target, fps, order=2)


ACCELERATION_ERROR = Metric(
    "acceleration_error",
    "Acceleration error",
    "m/s²",
    False,
    "Kanazawa et al. 2019",
    "predicted, target, fps",
    acceleration_error,
    by_clip_steps(2),
)


def jerk_error(
    predicted: Float[np.ndarray, "*clips frames joints 3"],
    target: Float[np.ndarray, "*clips frames joints 3"],
    fps: float,
) -> float:
    """Mean distance between predicted and true joint jerks, m/s³."""
    return _derivative_error(predicted, target, fps, order=3)


JERK_ERROR = Metric(
    "jerk_error",
    "Jerk error",
    "m/s³",
    False,
    "mean joint distance of third differences",
    "predicted, target, fps",
    jerk_error,
    by_clip_steps(3),
)


def _derivative_error(
    predicted: Float[np.ndarray, "*clips frames joints 3"],
    target: Float[np.ndarray, "*clips frames joints 3"],
    fps: float,
    *,
    order: int,
) -> float:
    # Clips have an axis of their own, so that no difference is taken across two sequences. Differences are linear: the
    # difference of derivatives is the derivative of the difference.
    difference = checked_difference(predicted, target)
    num_frames = difference.shape[-3]
    if num_frames <= order:
        raise ValueError(f"a derivative of order {order} needs at least {order + 1} frames, not {num_frames}")
    derivative = np.diff(difference, n=order, axis=-3) * checked_fps(fps) ** order
    return float(np.linalg.norm(derivative, axis=-1).mean())
