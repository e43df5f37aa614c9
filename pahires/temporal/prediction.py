"""From a network's output to poses: directly, or as a correction to an interpolation, perhaps exact at given frames."""

from dataclasses import dataclass, replace

import torch

from motionkit.core.shapes import Float32
from motionkit.training.networks import VectorScaling
from pahires.temporal.base_curves import interpolated, located, seconds_beyond
from pahires.temporal.network import ObservedWindow, TemporalNetwork
from pahires.temporal.settings import AnswerSettings, Sizing

HALF_SIZE_SECONDS = 0.35
# A cubic errs by about a sixth of (gap · change of velocity) half-way; with twice that, network outputs are near ½.
SHARE_OF_BEND = 0.3
# Half of it between frames this close: such fast changes are the capture's noise, which is not predictable.
NOISE_SECONDS = 0.04
# Minimum change of velocity, as a share of the speed and in deviations per second, for straight or still motion.
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


Rows = Float32[torch.Tensor, "batch queries numbers"]


@dataclass(frozen=True, eq=False)
class Predictor:
    """A network with the form of its answer.

    `plain`: the network's rows. `residual`: interpolation + scale · size · network. `exact`: interpolation + scale ·
    size · gate · network; the gate is 0 at observed frames, so that they are kept. For `size` (by `sizing`) and `gate`
    see `pahires.temporal.prediction`.

    With `blended` curves the network answers one more weight w for each of them and each number, which adds
    w · (that curve − the base): captures differ in which interpolation suits them, and in which joints.
    """

    network: TemporalNetwork
    scaling: VectorScaling
    answer: AnswerSettings

    def __call__(self, window: ObservedWindow) -> Rows:
        """Standardised rows at the queries, as training compares them with what was there."""
        if self.answer.form == "plain":
            return self.network(window).float()
        base = interpolated(window, self.answer.base, self.scaling)
        return base + self._correction(window, base)

    def smooth(self, window: ObservedWindow) -> Rows:
        """Standardised rows at the queries, as a motion field gives them: corrections averaged over a short time.

        A correction that is 0 at each observed frame has a kink there, and a network's answers differ from instant to
        instant by more than a body does. So a correction is the mean, weighed ¼, ½, ¼, of three, a quarter of the
        observed frames' spacing apart; in the form `exact` what that leaves at observed frames is taken away again by
        the curve through it. Plain answers stay as they are.
        """
        if self.answer.form == "plain" or window.times_seconds.shape[1] == 1:
            return self(window)
        base, averaged = self._averaged(window)
        if self.answer.form == "exact":
            _, left = self._averaged(window.at(window.times_seconds))
            averaged = averaged - interpolated(replace(window, frames=left), "eased", self.scaling)
        return base + averaged

    def _correction(self, window: ObservedWindow, base: Rows) -> Rows:
        """What is added to `base`, the interpolation at the queries."""
        added, *weights = self.network(window).float().chunk(1 + len(self.answer.curves), dim=-1)
        correction = self.answer.scale * size(window, self.answer.sizing) * added
        if self.answer.form == "exact":
            correction = gate(window) * correction
        for curve, weight in zip(self.answer.curves, weights, strict=True):
            correction = correction + weight * (interpolated(window, curve, self.scaling) - base)
        return correction

    def _averaged(self, window: ObservedWindow) -> tuple[Rows, Rows]:
        """The interpolation at the queries, and what is added to it."""
        apart = window.times_seconds.diff(dim=1).median(dim=1, keepdim=True).values / 4.0
        here = window.queries_seconds
        three = window.at(torch.cat((here - apart, here, here + apart), dim=1))
        bases = interpolated(three, self.answer.base, self.scaling)
        before, middle, after = self._correction(three, bases).chunk(3, dim=1)
        return bases.chunk(3, dim=1)[1], 0.25 * before + 0.5 * middle + 0.25 * after


def num_answers(settings: AnswerSettings, num_features: int) -> int:
    """Numbers that a network answers for each query: a row, and a row of weights for each blended curve."""
    return num_features * (1 + len(settings.curves))
