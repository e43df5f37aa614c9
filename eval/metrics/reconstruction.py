"""How far reconstructed poses are from the true ones: MPJPE in metres, angles, MRE in a vector's raw units.

Arrays hold valid frames only, of one sequence or of many concatenated; every frame has the same weight and padding
has none.
"""

import numpy as np
from jaxtyping import Float

from eval.metrics.checks import checked_difference, checked_quaternions


def mpjpe_global(
    predicted: Float[np.ndarray, "frames joints 3"], target: Float[np.ndarray, "frames joints 3"]
) -> float:
    """Mean distance between predicted and true joints in metres, the body's path included."""
    difference = checked_difference(predicted, target)
    return float(np.linalg.norm(difference, axis=-1).mean())


def mpjpe_root_aligned(
    predicted: Float[np.ndarray, "frames joints 3"], target: Float[np.ndarray, "frames joints 3"], root: int = 0
) -> float:
    """Mean distance in metres with every frame's root moved onto the true one (the root itself counts, as 0).

    This is what motion-latent-diffusion and the NeRM paper's Table 4 call MPJPE.
    """
    difference = checked_difference(predicted, target)
    difference -= difference[:, root : root + 1].copy()
    return float(np.linalg.norm(difference, axis=-1).mean())


def mpjpe_procrustes(
    predicted: Float[np.ndarray, "frames joints 3"], target: Float[np.ndarray, "frames joints 3"]
) -> float:
    """Mean distance in metres after the best rotation, translation and scale of every frame (PA-MPJPE; Gower 1975)."""
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


def rotation_angle_error(
    predicted: Float[np.ndarray, "frames joints 4"], target: Float[np.ndarray, "frames joints 4"]
) -> float:
    """Mean angle in degrees of the turn from each predicted joint rotation to the true one (geodesic distance).

    Unit quaternions of either sign, local or global ones on both sides. Raises `ValueError` for others.
    """
    checked_difference(predicted, target)
    checked_quaternions(predicted, target)
    p, q = predicted.astype(np.float64), target.astype(np.float64)
    # ‖p − q‖ and ‖p + q‖ are 2·sin and 2·cos of a quarter of the angle: exact for small angles, where arccos is not.
    apart, together = np.linalg.norm(p - q, axis=-1), np.linalg.norm(p + q, axis=-1)
    quarter = np.arctan2(np.minimum(apart, together), np.maximum(apart, together))
    return float(np.degrees(4.0 * quarter).mean())


def mre(predicted: Float[np.ndarray, "frames numbers"], target: Float[np.ndarray, "frames numbers"]) -> float:
    """Root-mean-square difference over all numbers of the redundant pose vectors, in their raw units.

    The NeRM paper defines MRE as the Euclidean distance between two pose vectors, but its 0.041 beside an MPJPE of
    0.016 cannot be that norm; `mean_vector_distance` is the literal definition.
    """
    difference = checked_difference(predicted, target)
    return float(np.sqrt(np.mean(difference * difference)))


def mean_vector_distance(
    predicted: Float[np.ndarray, "frames numbers"], target: Float[np.ndarray, "frames numbers"]
) -> float:
    """Mean Euclidean distance between pose vectors: MRE as the paper words it (L2 norm, raw units)."""
    return float(np.linalg.norm(checked_difference(predicted, target), axis=-1).mean())
