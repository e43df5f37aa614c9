"""Batched interpolation of observed frames in torch: the base that a network's output corrects.

Hold, linear, Catmull-Rom and cubic (natural ends) are elementwise; SLERP rotates each joint on its great arc. Beyond
both ends all continue at the end velocity, damped within `DAMPING_SECONDS`: after a second at constant velocity, errors
are metres. `eased` is the cubic, straightened in gaps so long that it would overshoot.
"""

from dataclasses import dataclass

import numpy as np
import torch

from motionkit.core.shapes import Float32, Float64, Int64
from motionkit.core.skeleton import Skeleton
from motionkit.features import rotations
from motionkit.fields.interpolation import inner_rates
from motionkit.training.networks import VectorScaling
from pahires.temporal.network import ObservedWindow
from pahires.temporal.settings import Base

# Deviations are at least this share of their group's: toes and collars hardly turn, and their noise would be learnt
# instead.
FLOOR_SHARE = 0.25
SMALLEST = 1e-4


PoseRows = Float32[np.ndarray, "batch frames numbers"]
"""World or window rows of B windows."""


@dataclass(frozen=True, eq=False)
class WindowFrames:
    """The coordinate frames of B windows in the world: yaw in radians and origin (x, z) in metres.

    Both are the root's at the middle observed frame, which depends on observed frames alone.
    """

    yaw: Float64[np.ndarray, "batch"]
    origin: Float64[np.ndarray, "batch 2"]

    @classmethod
    def of(cls, observed: PoseRows, skeleton: Skeleton) -> "WindowFrames":
        """The coordinate frames of windows from their observed world rows."""
        middle = observed[:, (observed.shape[1] - 1) // 2]
        return cls(rotations.heading(middle, skeleton), middle[:, (0, 2)].astype(np.float64))

    def to_window(self, rows: PoseRows) -> PoseRows:
        """World → window."""
        return rotations.to_window(rows, self.yaw, self.origin)

    def to_world(self, rows: PoseRows) -> PoseRows:
        """Window → world."""
        return rotations.to_world(rows, self.yaw, self.origin)


def measure_scaling(rows: Float32[np.ndarray, "frames numbers"]) -> VectorScaling:
    """Mean and scale of rows in their windows' frames.

    A number's scale is its standard deviation, but at least a quarter of its group's (root mean square): groups are the
    root's path (x and z, with a common scale), its height, the root's rotation and the joints' rotations.
    """
    rows = rows.astype(np.float64)
    mean, variance = rows.mean(axis=0), rows.var(axis=0)
    variance[[0, 2]] = variance[[0, 2]].mean()
    for group in (slice(0, 3, 2), slice(1, 2), slice(3, 9), slice(9, None)):
        floor = FLOOR_SHARE**2 * variance[group].mean()
        variance[group] = np.maximum(variance[group], max(floor, SMALLEST**2))
    return VectorScaling(
        torch.from_numpy(mean.astype(np.float32)), torch.from_numpy(np.sqrt(variance).astype(np.float32))
    )


DAMPING_SECONDS = 0.2
# Gaps of this length are half-way between the cubic and the straight line.
EASING_SECONDS = 0.5

_Gaps = Float32[torch.Tensor, "batch segments 1"]
_Slopes = Float32[torch.Tensor, "batch segments numbers"]
_Rates = Float32[torch.Tensor, "batch frames numbers"]


@torch.no_grad()
def interpolated(
    window: ObservedWindow, base: Base, scaling: VectorScaling
) -> Float32[torch.Tensor, "batch queries numbers"]:
    """Standardised rows at the queries by the interpolation `base`; one observed frame stays as it is."""
    segment, fraction = located(window)
    if window.frames.shape[1] == 1:
        return window.frames.expand(-1, segment.shape[1], -1)
    if base == "hold":
        last = window.queries_seconds >= window.times_seconds[:, -1:]
        return _rows(window.frames, torch.where(last, window.frames.shape[1] - 1, segment))
    gaps = window.times_seconds.diff(dim=1)[..., None]
    slopes = window.frames.diff(dim=1) / gaps
    if base in ("linear", "slerp"):
        ends = slopes[:, [0, -1]]
        inside = (
            torch.lerp(_rows(window.frames, segment), _rows(window.frames, segment + 1), fraction[..., None])
            if base == "linear"
            else _on_great_arcs(window.frames, segment, fraction, scaling)
        )
    else:
        rates = _parabola_rates(gaps, slopes) if base == "catmull-rom" else _spline_rates(gaps, slopes)
        ends = rates[:, [0, -1]]
        bent = 1.0 if base != "eased" else 1.0 / (1.0 + (gaps / EASING_SECONDS) ** 4)
        bends = bent * (rates[:, :-1] - slopes), bent * (rates[:, 1:] - slopes)
        inside = _bent(window.frames, bends, _rows(gaps, segment), segment, fraction)
    return inside + _beyond(window, ends)


def located(
    window: ObservedWindow,
) -> tuple[Int64[torch.Tensor, "batch queries"], Float32[torch.Tensor, "batch queries"]]:
    """Each query's segment between observed frames, and its position in it, in [0, 1].

    Queries beyond an end belong to the outermost segment, at its end.
    """
    times = window.times_seconds.contiguous()
    segment = torch.searchsorted(times, window.queries_seconds.contiguous(), right=True) - 1
    segment = segment.clamp(0, max(0, times.shape[1] - 2))
    before, after = times.gather(1, segment), times.gather(1, (segment + 1).clamp(max=times.shape[1] - 1))
    fraction = (window.queries_seconds - before) / (after - before).clamp(min=1e-9)
    return segment, fraction.clamp(0.0, 1.0)


def seconds_beyond(window: ObservedWindow) -> Float32[torch.Tensor, "batch queries"]:
    """Signed distance of each query beyond the observed frames in seconds: negative before them, 0 inside."""
    queries = window.queries_seconds
    return queries - torch.minimum(torch.maximum(queries, window.times_seconds[:, :1]), window.times_seconds[:, -1:])


def _rows(
    values: Float32[torch.Tensor, "batch frames numbers"], index: Int64[torch.Tensor, "batch queries"]
) -> Float32[torch.Tensor, "batch queries numbers"]:
    return values.gather(1, index[..., None].expand(-1, -1, values.shape[2]))


def _parabola_rates(gaps: _Gaps, slopes: _Slopes) -> _Rates:
    """Catmull-Rom's rates at the frames."""
    inner = inner_rates(gaps.transpose(0, 1), slopes.transpose(0, 1)).transpose(0, 1)
    return torch.cat((slopes[:, :1], inner, slopes[:, -1:]), dim=1)


def _spline_rates(gaps: _Gaps, slopes: _Slopes) -> _Rates:
    """The natural cubic spline's rates at the frames: continuous acceleration inside, none at the ends."""
    inverse = 1.0 / gaps[..., 0]
    off_diagonal = torch.diag_embed(inverse, 1) + torch.diag_embed(inverse, -1)
    diagonal = torch.nn.functional.pad(inverse, (1, 0)) + torch.nn.functional.pad(inverse, (0, 1))
    pull = 3.0 * slopes * inverse[..., None]
    right = torch.nn.functional.pad(pull, (0, 0, 1, 0)) + torch.nn.functional.pad(pull, (0, 0, 0, 1))
    rates: torch.Tensor = torch.linalg.solve(off_diagonal + torch.diag_embed(2.0 * diagonal), right)
    return rates


def _bent(
    frames: Float32[torch.Tensor, "batch frames numbers"],
    bends: tuple[_Slopes, _Slopes],
    gap: Float32[torch.Tensor, "batch queries 1"],
    segment: Int64[torch.Tensor, "batch queries"],
    fraction: Float32[torch.Tensor, "batch queries"],
) -> Float32[torch.Tensor, "batch queries numbers"]:
    """Cubic Hermite segments, as straight lines plus terms in the end rates' differences from the line's slope."""
    u = fraction[..., None]
    v = 1.0 - u
    line = torch.lerp(_rows(frames, segment), _rows(frames, segment + 1), u)
    return line + gap * u * v * (v * _rows(bends[0], segment) - u * _rows(bends[1], segment))


def _on_great_arcs(
    frames: Float32[torch.Tensor, "batch frames numbers"],
    segment: Int64[torch.Tensor, "batch queries"],
    fraction: Float32[torch.Tensor, "batch queries"],
    scaling: VectorScaling,
) -> Float32[torch.Tensor, "batch queries numbers"]:
    rows = scaling.invert(frames)
    root = torch.lerp(_rows(rows[..., :3], segment), _rows(rows[..., :3], segment + 1), fraction[..., None])
    import roma  # imports torch's compiler: a second and a half, which other bases need not spend

    # Rows are joint, column, axis; roma's matrices have columns last.
    joints = (rows.shape[-1] - 3) // 6
    columns = rows[..., 3:].reshape(*rows.shape[:-1], joints, 2, 3).transpose(-1, -2)
    matrices = roma.special_gramschmidt(columns)
    turns = roma.rotmat_to_rotvec(matrices[:, :-1].transpose(-1, -2) @ matrices[:, 1:])
    turn = _rows(turns.flatten(2), segment).reshape(*segment.shape, joints, 3)
    start = _rows(matrices.flatten(2), segment).reshape(*segment.shape, joints, 3, 3)
    between = start @ roma.rotvec_to_rotmat(fraction[..., None, None] * turn)
    turned = between[..., :2].transpose(-1, -2).flatten(2)
    return scaling.apply(torch.cat((root, turned), dim=-1))


def _beyond(
    window: ObservedWindow, end_rates: Float32[torch.Tensor, "batch 2 numbers"]
) -> Float32[torch.Tensor, "batch queries numbers"]:
    beyond = seconds_beyond(window)[..., None]
    reach = DAMPING_SECONDS * (1.0 - torch.exp(-beyond.abs() / DAMPING_SECONDS))
    return torch.where(beyond < 0, -reach * end_rates[:, :1], reach * end_rates[:, 1:])
