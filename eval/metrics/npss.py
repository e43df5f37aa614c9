"""NPSS: normalised power spectrum similarity of predicted and true motion."""

import numpy as np
from jaxtyping import Float, Float64

from eval.metrics.checks import checked_difference


def npss(
    predicted: Float[np.ndarray, "clips frames numbers"], target: Float[np.ndarray, "clips frames numbers"]
) -> float:
    """Distance of normalised power spectra over time, each number of each clip weighted by its true power; 0 is best.

    The distance is the L1 distance of cumulative spectra (an earth mover's distance). As in the LaFAN1 benchmark, power
    is the square of the **real part** of the Fourier coefficients, not of their modulus: figures are comparable only
    so, and depend on where a clip starts. A number without predicted power has an empty spectrum; one without true
    power has no weight. Raises `ValueError` where nothing has power. Source: Gopalakrishnan et al. 2019, §4.2.
    """
    checked_difference(predicted, target)
    true = _power(target)
    weights = true.sum(axis=1)
    total = weights.sum()
    if total == 0:
        raise ValueError("target has no power in any number: its normalised spectrum does not exist")
    distance = np.abs(_cumulative(_power(predicted)) - _cumulative(true)).sum(axis=1)
    return float((distance * weights).sum() / total)


def npss_weight(target: Float[np.ndarray, "clips frames numbers"]) -> float:
    """The total true power by which a batch's NPSS counts in the NPSS of many batches of equal length."""
    return float(_power(target).sum())


def _power(signal: Float[np.ndarray, "clips frames numbers"]) -> Float64[np.ndarray, "clips frames numbers"]:
    return np.square(np.fft.fft(signal.astype(np.float64), axis=1).real)


def _cumulative(
    power: Float64[np.ndarray, "clips frames numbers"],
) -> Float64[np.ndarray, "clips frames numbers"]:
    total = power.sum(axis=1, keepdims=True)
    return np.asarray(np.cumsum(power / np.where(total > 0, total, 1.0), axis=1))
