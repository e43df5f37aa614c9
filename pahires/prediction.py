"""From a network's answer to poses: as they are, or as a correction of an interpolation that may leave frames alone."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float32

from pahires.base_curves import interpolated
from pahires.correction_size import gate, size
from pahires.network import ObservedWindow, TemporalNetwork
from pahires.scaling import Scaling
from pahires.settings import Base, Form, Sizing, TemporalSettings

Rows = Float32[torch.Tensor, "batch queries numbers"]


@dataclass(frozen=True, eq=False)
class Predictor:
    """A network with the form of its answer.

    `plain`: the network's rows. `residual`: interpolation + scale · size · network. `exact`: interpolation + scale ·
    size · gate · network; the gate is 0 at observed frames, so that they are kept. For `size` (by `sizing`) and `gate`
    see `pahires.correction_size`.

    With `blended` curves the network answers one more weight w for each of them and each number, which adds
    w · (that curve − the base): captures differ in which interpolation suits them, and in which joints.
    """

    network: TemporalNetwork
    scaling: Scaling
    form: Form
    base: Base
    correction_scale: float
    sizing: Sizing = "gap"
    blended: tuple[Base, ...] = ()

    def __call__(self, window: ObservedWindow) -> Rows:
        """Standardised rows at the queries, as training compares them with what was there."""
        if self.form == "plain":
            return self.network(window).float()
        base = interpolated(window, self.base, self.scaling)
        return base + self._correction(window, base)

    def smooth(self, window: ObservedWindow) -> Rows:
        """Standardised rows at the queries, as a motion field gives them: corrections averaged over a short time.

        A correction that is 0 at each observed frame has a kink there, and a network's answers differ from instant to
        instant by more than a body does. So a correction is the mean, weighed ¼, ½, ¼, of three, a quarter of the
        observed frames' spacing apart; in the form `exact` what that leaves at observed frames is taken away again by
        the curve through it. Plain answers stay as they are.
        """
        if self.form == "plain" or window.times_seconds.shape[1] == 1:
            return self(window)
        base, averaged = self._averaged(window)
        if self.form == "exact":
            _, left = self._averaged(window.asked(window.times_seconds))
            averaged = averaged - interpolated(replace(window, frames=left), "eased", self.scaling)
        return base + averaged

    def _correction(self, window: ObservedWindow, base: Rows) -> Rows:
        """What is added to `base`, the interpolation at the queries."""
        added, *weights = self.network(window).float().chunk(1 + len(self.blended), dim=-1)
        correction = self.correction_scale * size(window, self.sizing) * added
        if self.form == "exact":
            correction = gate(window) * correction
        for curve, weight in zip(self.blended, weights, strict=True):
            correction = correction + weight * (interpolated(window, curve, self.scaling) - base)
        return correction

    def _averaged(self, window: ObservedWindow) -> tuple[Rows, Rows]:
        """The interpolation at the queries, and what is added to it."""
        apart = window.times_seconds.diff(dim=1).median(dim=1, keepdim=True).values / 4.0
        here = window.queries_seconds
        three = window.asked(torch.cat((here - apart, here, here + apart), dim=1))
        bases = interpolated(three, self.base, self.scaling)
        before, middle, after = self._correction(three, bases).chunk(3, dim=1)
        return bases.chunk(3, dim=1)[1], 0.25 * before + 0.5 * middle + 0.25 * after


def predictor_of(network: TemporalNetwork, scaling: Scaling, settings: TemporalSettings) -> Predictor:
    """A network with the form of answer that its training has."""
    return Predictor(
        network,
        scaling,
        settings.form,
        settings.base,
        settings.correction_scale,
        settings.sizing,
        settings.curves,
    )


def num_answers(settings: TemporalSettings, num_numbers: int) -> int:
    """Numbers that a network answers for each query: a row, and a row of weights for each blended curve."""
    return num_numbers * (1 + len(settings.curves))
