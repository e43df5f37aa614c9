"""How large a correction of an interpolation may be: what a network's answer is multiplied by."""

import torch
from jaxtyping import Float32

from pahires.base_curves import located, seconds_beyond
from pahires.network import ObservedWindow
from pahires.settings import Sizing

HALF_SIZE_SECONDS = 0.35
# A cubic misses about a sixth of (gap · change of velocity) half-way; twice that leaves a network's answers near ½.
SHARE_OF_BEND = 0.3
# Between frames this close only half of it: what changes so fast is the capture's noise, and nobody foresees that.
NOISE_SECONDS = 0.04
# Of the speed, and in deviations per second: what counts as a change of velocity where frames lie on a line, or rest.
STRAIGHT_SHARE, REST_RATE = 0.1, 0.01


def size(window: ObservedWindow, sizing: Sizing) -> Float32[torch.Tensor, "batch queries 1"]:
    """How much an interpolation may miss at each query.

    `gap`: by the time h between the observed frames, 1 / (1 + (0.35 s / h)²), 0 to 1. Errors of interpolation grow with
    the square of h until nothing is known. So a network's answers are of one size for short and for long gaps, and
    those for frames closer than any that training saw stay small. Beyond the ends h is twice the time from the end, as
    if the same stretch followed there.

    `motion`: by what the frames do as well, 0.3 · h · j / (1 + (0.04 s / h)²), j the root mean square change of
    velocity at both frames: over captures, errors of the cubic are proportional to h · j (exponents 1.2 and 1.0, fitted
    to windows of all tasks), so answers are of one size for a dash and for someone who stands. Beyond the ends j is the
    speed and h as above; one observed frame is taken by `gap`.
    """
    beyond = 2.0 * seconds_beyond(window).abs()
    if window.times_seconds.shape[1] == 1:
        return _by_time(beyond)[..., None]
    segment, _ = located(window)
    gaps = window.times_seconds.diff(dim=1)
    length = torch.where(beyond > 0, beyond, gaps.gather(1, segment))
    if sizing == "gap":
        return _by_time(length)[..., None]
    slopes = window.frames.diff(dim=1) / gaps[..., None]
    speed = slopes.square().mean(dim=2)
    bend = speed if slopes.shape[1] == 1 else _mean_of_neighbours(slopes.diff(dim=1).square().mean(dim=2))
    inside = (bend + STRAIGHT_SHARE**2 * speed + REST_RATE**2).sqrt().gather(1, segment)
    outside = (speed + STRAIGHT_SHARE**2).sqrt().gather(1, segment)
    near = length.square() / (length.square() + NOISE_SECONDS**2)
    return (SHARE_OF_BEND * length * torch.where(beyond > 0, outside, near * inside))[..., None]


def gate(window: ObservedWindow) -> Float32[torch.Tensor, "batch queries 1"]:
    """4u(1 − u), u the fraction between two observed frames: 0 at them, 1 half-way; 1 beyond the ends.

    Its slope at a frame is not 0: the velocity there may be corrected too.
    """
    _, fraction = located(window)
    inside = 4.0 * fraction * (1.0 - fraction)
    return torch.where(seconds_beyond(window) == 0, inside, 1.0)[..., None]


def _by_time(seconds: Float32[torch.Tensor, "batch queries"]) -> Float32[torch.Tensor, "batch queries"]:
    return seconds.square() / (seconds.square() + HALF_SIZE_SECONDS**2)


def _mean_of_neighbours(
    inner: Float32[torch.Tensor, "batch inner"],
) -> Float32[torch.Tensor, "batch segments"]:
    """Of what is known at the inner frames the mean at both frames of each segment; ends have their neighbour's."""
    at = torch.cat((inner[:, :1], inner, inner[:, -1:]), dim=1)
    return (at[:, 1:] + at[:, :-1]) / 2
