"""From a network's answer to poses: as they are, or as a correction of an interpolation that may leave frames alone."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Float32

from pahires.base_curves import DAMPING_SECONDS, interpolated, located, seconds_beyond
from pahires.network import ObservedWindow, TemporalNetwork
from pahires.scaling import Scaling
from pahires.settings import Base, Form


@dataclass(frozen=True, eq=False)
class Predictor:
    """A network with the form of its answer.

    `plain`: the network's rows. `residual`: interpolation + scale · network. `exact`: interpolation + scale · gate ·
    network; the gate 4u(1 − u), u the fraction between observed frames, is 0 at them, so that they are kept, and beyond
    the ends it is 1 − exp(−seconds / 0.2). Its slope at a frame is not 0: the velocity there may be corrected.
    """

    network: TemporalNetwork
    scaling: Scaling
    form: Form
    base: Base
    correction_scale: float

    def __call__(self, window: ObservedWindow) -> Float32[torch.Tensor, "batch queries numbers"]:
        """Standardised rows at the queries."""
        answer: Float[torch.Tensor, "batch queries numbers"] = self.network(window).float()
        if self.form == "plain":
            return answer
        curve = interpolated(window, self.base, self.scaling)
        if self.form == "residual":
            return curve + self.correction_scale * answer
        return curve + self.correction_scale * gate(window) * answer


def gate(window: ObservedWindow) -> Float32[torch.Tensor, "batch queries 1"]:
    """0 at observed frames, 1 in the middle between two, towards 1 beyond the ends."""
    _, fraction = located(window)
    beyond = 1.0 - torch.exp(-seconds_beyond(window).abs() / DAMPING_SECONDS)
    return torch.maximum(4.0 * fraction * (1.0 - fraction), beyond)[..., None]
