"""The scale of the native evaluator's features."""

import numpy as np
import pytest

from eval.native_evaluator.evaluator import shrunk_whitening


def test_known_variances_become_their_shrunk_ones() -> None:
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    deviation = np.array([3.0, 1.0, 1.0, 0.001])
    by_framerate = [rng.normal(size=(200_000, 4)) * deviation @ turn + mean for mean in (0.0, 100.0)]
    whitening = shrunk_whitening(by_framerate)
    np.testing.assert_allclose(whitening, whitening.T, atol=1e-6)
    variance = np.var(by_framerate[0] @ whitening @ turn.T, axis=0)
    mean = np.mean(deviation**2)
    np.testing.assert_allclose(variance, deviation**2 / (deviation**2 + mean), rtol=0.02)


def test_the_scale_of_the_embedding_does_not_count() -> None:
    embeddings = np.random.default_rng(1).normal(size=(50, 6)) * np.arange(1, 7)
    once, larger = (each @ shrunk_whitening([each]) for each in (embeddings, 1000 * embeddings))
    np.testing.assert_allclose(once, larger, rtol=1e-4)


def test_constant_embeddings_stay_finite_and_one_clip_is_refused() -> None:
    assert np.isfinite(np.ones((5, 3)) @ shrunk_whitening([np.ones((5, 3))])).all()
    with pytest.raises(ValueError, match="at least two"):
        shrunk_whitening([np.ones((5, 3)), np.ones((1, 3))])
