"""Offsets of the body and each foot: a banded least-squares problem along time, linear in its length.

The unknowns at every sample of the grid are the body's offset r and each foot's additional offset f. The objective
asks for velocities that cancel the sliding of feet in contact (ṙ + ḟ = −e) and for heights on the ground; it penalises
feet away from their original position (f², more while they swing) and accelerations (f̈², r̈²). What both feet share
ends up in r, which doesn't bend the knees; the rest fades out while a foot swings.
"""

from dataclasses import dataclass

import numpy as np

from motionkit.core.shapes import Float64

KINDS = 3
_BAND = 2 * KINDS + 1


@dataclass(frozen=True)
class Costs:
    """Weights of the cost terms, relative to 1 for (m/s)² of sliding: `keep` of metres², `sudden` of (m/s²)².

    `foot_down` and `foot_up` weigh a foot's distance from its original position in contact and in swing.
    """

    foot_down: float
    foot_up: float
    foot_sudden: float
    body: float
    body_sudden: float


@dataclass(frozen=True, eq=False)
class Wishes:
    """Targets for a foot's total offset: `velocity` between neighbours and `place`, with weights."""

    velocity: Float64[np.ndarray, "steps feet axes"]
    velocity_weight: Float64[np.ndarray, "steps feet"]
    place: Float64[np.ndarray, "instants feet axes"]
    place_weight: Float64[np.ndarray, "instants feet"]


def solve_offsets(
    wishes: Wishes, down: Float64[np.ndarray, "instants feet"], fps: float, costs: Costs
) -> Float64[np.ndarray, "instants 3 axes"]:
    """The least-cost offsets of body, left and right foot, metres; a foot's total offset is body plus foot."""
    from scipy.linalg import solveh_banded

    count, axes = len(down), wishes.place.shape[-1]
    band = np.zeros((_BAND, count, KINDS))  # band[d, t, k]: the entry of unknown (t, k) and the one d places after it
    right = np.zeros((count, KINDS, axes))
    _add_keep(band, down, costs)
    _add_sudden(band, fps, costs)
    for foot in range(2):
        _add_velocity(band, right, foot, wishes, fps)
        _add_place(band, right, foot, wishes)
    lower = band.reshape(_BAND, count * KINDS)
    solved = solveh_banded(lower, right.reshape(count * KINDS, axes), lower=True, overwrite_ab=True, check_finite=False)
    return np.asarray(solved).reshape(count, KINDS, axes)


def _add_keep(
    band: Float64[np.ndarray, "band instants 3"], down: Float64[np.ndarray, "instants feet"], costs: Costs
) -> None:
    band[0, :, 0] += costs.body
    band[0, :, 1:] += costs.foot_up + (costs.foot_down - costs.foot_up) * down


def _add_sudden(band: Float64[np.ndarray, "band instants 3"], fps: float, costs: Costs) -> None:
    sudden = np.array([costs.body_sudden, costs.foot_sudden, costs.foot_sudden]) * fps**4
    for first, factor in ((0, 1.0), (1, -2.0), (2, 1.0)):
        for second, other in ((0, 1.0), (1, -2.0), (2, 1.0)):
            if second >= first:
                stop = band.shape[1] - 2 + first
                band[KINDS * (second - first), first:stop] += sudden * factor * other


def _add_velocity(
    band: Float64[np.ndarray, "band instants 3"],
    right: Float64[np.ndarray, "instants 3 axes"],
    foot: int,
    wishes: Wishes,
    fps: float,
) -> None:
    """Weight · |(r + f)(t + 1) − (r + f)(t) − v/fps|² · fps²."""
    own = 1 + foot
    weight = wishes.velocity_weight[:, foot] * fps**2
    for earlier, rows in ((True, slice(None, -1)), (False, slice(1, None))):
        sign = -1.0 if earlier else 1.0
        pull = sign * weight[:, None] * wishes.velocity[:, foot] / fps
        for kind in (0, own):
            band[0, rows, kind] += weight
            right[rows, kind] += pull
        band[own, rows, 0] += weight  # body and foot of one sample
    for kind in (0, own):
        band[KINDS, :-1, kind] -= weight  # each with itself one sample later
    band[KINDS + own, :-1, 0] -= weight  # the body with the foot one sample later
    band[KINDS - own, :-1, own] -= weight  # the foot with the body one sample later


def _add_place(
    band: Float64[np.ndarray, "band instants 3"],
    right: Float64[np.ndarray, "instants 3 axes"],
    foot: int,
    wishes: Wishes,
) -> None:
    own = 1 + foot
    weight = wishes.place_weight[:, foot]
    for kind in (0, own):
        band[0, :, kind] += weight
        right[:, kind] += weight[:, None] * wishes.place[:, foot]
    band[own, :, 0] += weight
