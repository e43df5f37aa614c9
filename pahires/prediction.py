"""From a network's answer to poses: as they are, or as a correction of an interpolation that may leave frames alone."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float32

from pahires.base_curves import interpolated, located, seconds_beyond
from pahires.network import ObservedWindow, TemporalNetwork
from pahires.scaling import Scaling
from pahires.settings import Base, Form

HALF_SIZE_SECONDS = 0.35


@dataclass(frozen=True, eq=False)
class Predictor:
    """A network with the form of its answer.

    `plain`: the network's rows. `residual`: interpolation + scale · size · network. `exact`: interpolation + scale ·
    size · gate · network; the gate is 0 at observed frames, so that they are kept. `size` and `gate`: below.
    """

    network: TemporalNetwork
    scaling: Scaling
    form: Form
    base: Base
    correction_scale: float

    def __call__(self, window: ObservedWindow) -> Float32[torch.Tensor, "batch queries numbers"]:
        """Standardised rows at the queries, as training compares them with what was there."""
        if self.form == "plain":
            return self.network(window).float()
        return interpolated(window, self.base, self.scaling) + self._correction(window)

    def smooth(self, window: ObservedWindow) -> Float32[torch.Tensor, "batch queries numbers"]:
        """Standardised rows at the queries, as a motion field gives them: corrections averaged over a short time.

        A correction that is 0 at each observed frame has a kink there, and a network's answers differ from instant to
        instant by more than a body does. So a correction is the mean, weighed ¼, ½, ¼, of three, a quarter of the
        observed frames' spacing apart; in the form `exact` what that leaves at observed frames is taken away again by
        the curve through it. Plain answers stay as they are.
        """
        if self.form == "plain" or window.times_seconds.shape[1] == 1:
            return self(window)
        averaged = self._averaged(window)
        if self.form == "exact":
            left = self._averaged(window.asked(window.times_seconds))
            averaged = averaged - interpolated(replace(window, frames=left), "eased", self.scaling)
        return interpolated(window, self.base, self.scaling) + averaged

    def _correction(self, window: ObservedWindow) -> Float32[torch.Tensor, "batch queries numbers"]:
        correction = self.correction_scale * size(window) * self.network(window).float()
        return correction if self.form == "residual" else gate(window) * correction

    def _averaged(self, window: ObservedWindow) -> Float32[torch.Tensor, "batch queries numbers"]:
        apart = window.times_seconds.diff(dim=1).median(dim=1, keepdim=True).values / 4.0
        here = window.queries_seconds
        three = window.asked(torch.cat((here - apart, here, here + apart), dim=1))
        before, middle, after = self._correction(three).chunk(3, dim=1)
        return 0.25 * before + 0.5 * middle + 0.25 * after


def size(window: ObservedWindow) -> Float32[torch.Tensor, "batch queries 1"]:
    """How much an interpolation may miss, 0 to 1, by the time h between the observed frames: 1 / (1 + (0.35 s / h)²).

    Errors of interpolation grow with the square of h until nothing is known. So a network's answers are of one size
    for short and for long gaps, and those for frames closer than any that training saw stay small. Beyond the ends h is
    twice the time from the end, as if the same stretch followed there.
    """
    segment, _ = located(window)
    length = 2.0 * seconds_beyond(window).abs()
    if window.times_seconds.shape[1] > 1:
        length = torch.where(length > 0, length, window.times_seconds.diff(dim=1).gather(1, segment))
    square = length.square()
    return (square / (square + HALF_SIZE_SECONDS**2))[..., None]


def gate(window: ObservedWindow) -> Float32[torch.Tensor, "batch queries 1"]:
    """4u(1 − u), u the fraction between two observed frames: 0 at them, 1 half-way; 1 beyond the ends.

    Its slope at a frame is not 0: the velocity there may be corrected too.
    """
    _, fraction = located(window)
    inside = 4.0 * fraction * (1.0 - fraction)
    return torch.where(seconds_beyond(window) == 0, inside, 1.0)[..., None]
