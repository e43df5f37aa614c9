"""The interface of temporal networks, which complete motion from observed frames.

Windows, coordinate frames and scaling, the loss, exactness at given frames and long motions are handled outside of the
network (`windows`, `prediction`, `training` and `encoder`), so models of this kind differ in their networks alone.
"""

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch

from motionkit.core.shapes import Float, Float32


@dataclass(frozen=True, eq=False)
class ObservedWindow:
    """B windows of N observed frames, and Q query instants.

    `frames` are standardised rotation rows; `times_seconds` increase strictly from 0, evenly or not; queries may lie
    anywhere, also beyond both ends, in any order. `query_spacing_seconds` is the frame spacing of the target framerate
    (the "cell" of LIIF), the same for all queries of a window. Times are float32 seconds from the window's first frame.
    """

    frames: Float32[torch.Tensor, "batch frames numbers"]
    times_seconds: Float32[torch.Tensor, "batch frames"]
    queries_seconds: Float32[torch.Tensor, "batch queries"]
    query_spacing_seconds: Float32[torch.Tensor, "batch"]

    def at(self, queries_seconds: Float32[torch.Tensor, "batch queries"]) -> "ObservedWindow":
        """The same windows with other query instants."""
        return replace(self, queries_seconds=queries_seconds)

    def to(self, device: torch.device) -> "ObservedWindow":
        """Move to a device."""
        return ObservedWindow(*(tensor.to(device) for tensor in vars(self).values()))


@runtime_checkable
class TemporalNetwork(Protocol):
    """A `torch.nn.Module` from observed frames to any instants; N may be 1 and differs from call to call."""

    def __call__(self, window: ObservedWindow) -> Float[torch.Tensor, "batch queries numbers"]:
        """Standardised rows at the queries (in residual forms: the correction to the interpolation).

        The output at a query depends on the window's frames and times and on that query, not on other queries.
        """
        ...
