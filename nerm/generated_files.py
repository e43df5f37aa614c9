"""Generated motions as files: sampled from their fields, written as .npz or .bvh."""

import os
import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from motionkit.errors import UsageError
from motionkit.formats.arrays import npz, npz_skeleton
from motionkit.formats.bvh.motion import write_bvh
from motionkit.generation import GenerationRequest
from motionkit.motion import Caption, Motion
from motionkit.motionfield import FramerateConditioned, MotionField
from motionkit.skeleton import Skeleton
from motionkit.timegrid import TimeGrid

SLUG_LENGTH = 40


@dataclass(frozen=True, eq=False)
class GeneratedSample:
    """Poses of one generated motion: uniformly at `fps`, or at arbitrary `seconds` where `fps` is None."""

    joint_positions: Float32[np.ndarray, "frames joints 3"]
    seconds: Float64[np.ndarray, "frames"]
    fps: Fraction | None
    duration_seconds: float
    skeleton: Skeleton
    caption: str
    action: str

    @property
    def captions(self) -> tuple[Caption, ...]:
        """The text that was asked for, if there was one."""
        return (Caption(self.caption),) if self.caption else ()

    def motion(self, fps: Fraction) -> Motion:
        """The poses as a motion at their uniform framerate."""
        grid = TimeGrid(fps, len(self.seconds), float(self.seconds[0]))
        return Motion(self.joint_positions, self.skeleton, grid, captions=self.captions, action=self.action)

    def description(self) -> dict[str, Any]:
        """What was made, as plain values."""
        return {
            "caption": self.caption,
            "action": self.action,
            "duration_seconds": self.duration_seconds,
            "fps": None if self.fps is None else str(self.fps),
            "num_frames": len(self.seconds),
        }


def sample_field(
    field: MotionField,
    request: GenerationRequest,
    fps: Fraction,
    times_seconds: Float64[np.ndarray, "times"] | None = None,
) -> GeneratedSample:
    """Sample a generated field: at `times_seconds`, or the frames k / fps of the half-open interval it lasts."""
    duration = field.end_seconds - field.start_seconds
    if times_seconds is None:
        if isinstance(field, FramerateConditioned):
            field = field.at_fps(fps)
        num_frames = max(1, int(np.ceil(duration * float(fps) - 1e-6)))
        seconds = TimeGrid(fps, num_frames, field.start_seconds).seconds()
    else:
        seconds = times_seconds
    return GeneratedSample(
        joint_positions=field.query(seconds).joint_positions,
        seconds=seconds,
        fps=fps if times_seconds is None else None,
        duration_seconds=duration,
        skeleton=field.skeleton,
        caption=request.text,
        action=request.action,
    )


def file_name(index: int, request: GenerationRequest) -> str:
    """A name for the index-th motion that says what was asked for: `0003-a-person-walks`."""
    slug = re.sub(r"[^a-z0-9]+", "-", (request.text or request.action or "unconditional").lower()).strip("-")
    return f"{index:04d}-{slug[:SLUG_LENGTH].strip('-') or 'motion'}"


def write_npz_file(path: Path, sample: GeneratedSample) -> None:
    """Write a .npz of `motionkit.formats.arrays.npz`'s schema, which appears whole or not at all.

    Poses at arbitrary instants have `time_seconds` and no `fps`. Beside the schema: `duration_seconds`, the interval
    that was asked for.
    """
    if sample.fps is None:
        arrays = {
            "joint_positions": sample.joint_positions,
            "time_seconds": sample.seconds,
            **npz_skeleton.skeleton_arrays(sample.skeleton),
            **npz.caption_arrays(sample.captions),
            "action": np.array(sample.action),
        }
    else:
        arrays = npz.motion_arrays(sample.motion(sample.fps))
    npz.write_arrays(path, {**arrays, "duration_seconds": np.float64(sample.duration_seconds)})


def write_bvh_file(path: Path, sample: GeneratedSample) -> None:
    """Write a .bvh that appears whole or not at all; raises `UsageError` for poses without a uniform framerate."""
    if sample.fps is None:
        raise UsageError("a BVH file has one framerate: write arbitrary instants as npz")
    motion = sample.motion(sample.fps)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    write_bvh(motion, temporary)
    temporary.replace(path)
