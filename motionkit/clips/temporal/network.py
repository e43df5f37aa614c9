"""What every network that continues a motion in time is asked, and what it answers.

Windows, their frames and scales, the loss, exactness at given frames and long motions lie outside of a network and are
written once (`windows`, `prediction`, `training` and `encoder` beside this), so models of this kind differ in their
networks alone.
"""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Float32


@dataclass(frozen=True, eq=False)
class ObservedWindow:
    """B windows of N observed frames, and Q instants at which their motion is asked for.

    `frames` are standardised rotation rows; `times_seconds` increase strictly from 0, evenly or not; queries may lie
    anywhere, also beyond both ends, in any order. `query_spacing_seconds` is the step of the framerate that is aimed at
    (the "cell" of LIIF), the same for all queries of a window. Times are float32 seconds from the window's first frame.
    """

    frames: Float32[torch.Tensor, "batch frames numbers"]
    times_seconds: Float32[torch.Tensor, "batch frames"]
    queries_seconds: Float32[torch.Tensor, "batch queries"]
    query_spacing_seconds: Float32[torch.Tensor, "batch"]

    def asked(self, queries_seconds: Float32[torch.Tensor, "batch queries"]) -> "ObservedWindow":
        """The same windows asked at other instants."""
        return replace(self, queries_seconds=queries_seconds)

    def to(self, device: torch.device) -> "ObservedWindow":
        """On another device."""
        return ObservedWindow(
            self.frames.to(device),
            self.times_seconds.to(device),
            self.queries_seconds.to(device),
            self.query_spacing_seconds.to(device),
        )


@runtime_checkable
class TemporalNetwork(Protocol):
    """A `torch.nn.Module` from observed frames to any instants; N may be 1 and differs from call to call."""

    def __call__(self, window: ObservedWindow) -> Float[torch.Tensor, "batch queries numbers"]:
        """Standardised rows at the queries (in residual forms: what is to be added to the interpolation).

        The answer to a query depends on the window's frames and times and on that query, not on what else is asked.
        """
        ...
