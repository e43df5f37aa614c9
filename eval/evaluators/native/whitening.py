"""The scale of the evaluator's features: how far clean motion spreads in each direction of the embedding.

Training leaves that scale to chance: what captions need takes most of it, and a Fréchet distance then sees which takes
were drawn before it sees mild damage (measured: at 40 fps other takes scored more than SLERP from 20 fps).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32

LEAST_VARIANCE = 1e-12


def shrunk_whitening(
    embeddings_by_framerate: Sequence[Float[np.ndarray, "_clips features"]],
) -> Float32[np.ndarray, "features features"]:
    """The symmetric matrix (C + c·1)^(−½) for clean clips' mean covariance C at one framerate, c its mean variance.

    Features times it vary about equally in all directions in which clean motion varies at all: a direction of far less
    than the mean variance stays small, so that what is nearly constant is not blown up. The framerates' means do not
    count: a comparison is between sets of one framerate. Raises `ValueError` where some framerate has one clip.
    """
    if any(len(embeddings) < 2 for embeddings in embeddings_by_framerate):
        raise ValueError("a covariance needs at least two clips of every framerate")
    rows = [np.asarray(embeddings, dtype=np.float64) for embeddings in embeddings_by_framerate]
    covariance = np.mean([np.atleast_2d(np.cov(each, rowvar=False)) for each in rows], axis=0)
    variances, directions = np.linalg.eigh(covariance)
    shrunk = np.maximum(variances, 0.0) + max(float(variances.mean()), LEAST_VARIANCE)
    whitening: Float32[np.ndarray, "features features"] = ((directions / np.sqrt(shrunk)) @ directions.T).astype(
        np.float32
    )
    return whitening
