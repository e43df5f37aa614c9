"""The interface of everything continuous: a domain in seconds, poses at any times in any order.

Splines, NeRM's decoded latents and PA-HiRes implement `MotionField`; upsampling, evaluation and export are written
once against it.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64

from motionkit.motion import Motion, Provenance
from motionkit.skeleton import Skeleton
from motionkit.timegrid import TimeGrid, num_frames_within


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses at some instants: positions in metres, and rotations (w, x, y, z) where the field has true ones."""

    joint_positions: Float32[np.ndarray, "times joints 3"]
    local_rotations: Float32[np.ndarray, "times joints 4"] | None = None
    root_translation: Float32[np.ndarray, "times 3"] | None = None


@runtime_checkable
class MotionField(Protocol):
    """A motion as a function of time on the closed interval [start_seconds, end_seconds]."""

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of the poses."""
        ...

    @property
    def start_seconds(self) -> float:
        """First instant of the domain."""
        ...

    @property
    def end_seconds(self) -> float:
        """Last instant of the domain."""
        ...

    def query(self, times_seconds: Float64[np.ndarray, "times"]) -> Poses:
        """Poses at any times inside the domain, in any order; raises `ValueError` outside it."""
        ...


@runtime_checkable
class FramerateConditioned(Protocol):
    """A field that also depends on the framerate at which it is sampled (the s of NeRM's Eq. 2)."""

    def at_fps(self, fps: Fraction) -> MotionField:
        """The same motion, told that it is sampled at this framerate."""
        ...


def check_times(field: MotionField, times_seconds: Float64[np.ndarray, "times"]) -> None:
    """Raise `ValueError` for times outside the field's domain (a microsecond of rounding is allowed)."""
    outside = (times_seconds < field.start_seconds - 1e-6) | (times_seconds > field.end_seconds + 1e-6)
    if np.any(outside):
        first = float(times_seconds[np.argmax(outside)])
        raise ValueError(
            f"{int(outside.sum())} of {times_seconds.size} times lie outside the motion, the first at {first:.4f} s; "
            f"its domain is [{field.start_seconds:.4f}, {field.end_seconds:.4f}] s"
        )


def to_motion(field: MotionField, fps: Fraction, provenance: Provenance | None = None) -> Motion:
    """Sample the whole field uniformly: frame k at start_seconds + k / fps."""
    if isinstance(field, FramerateConditioned):
        field = field.at_fps(fps)
    grid = TimeGrid(fps, num_frames_within(field.end_seconds - field.start_seconds, fps), field.start_seconds)
    poses = field.query(np.minimum(grid.seconds(), field.end_seconds))
    return Motion(
        joint_positions=poses.joint_positions,
        skeleton=field.skeleton,
        timegrid=grid,
        local_rotations=poses.local_rotations,
        root_translation=poses.root_translation,
        provenance=provenance or Provenance(),
    )
