"""All quality measures of one motion, and its flags."""

from dataclasses import dataclass, replace

import numpy as np

from motionkit.core.motion import Motion
from motionkit.features.quality.body import bone_length_drift, foot_skate, head_elevation
from motionkit.features.quality.steps import jitter, longest_steps, measure_steps, squared_differences
from motionkit.features.quality.upsampled import effective_fps

# Above these a sequence is flagged, not refused: real captures hold glitches and floors that are off, and the reader
# decides. docs/quality.md says where each figure comes from, docs/results/quality.md what it hits in real captures.
MAX_JOINT_SPEED = 30.0
MAX_FLOOR_HEIGHT = 0.25
MAX_JITTER = 400.0
MAX_FROZEN_SECONDS = 0.25
MAX_FOOT_SKATE_SHARE = 0.5
MAX_BONE_LENGTH_DRIFT = 0.1
# 30 degrees.
MAX_LYING_ELEVATION = 0.5


# Squares of larger numbers leave float32; a motion that reaches this far carries flags for it in any case.
FAR_METRES = 1e9


@dataclass(frozen=True)
class Quality:
    """Quality measures of a motion, and flags for suspicious ones.

    Speeds in m/s, jitter in m/s³, heights in metres, times in seconds from the first frame; None if not measurable: too
    short or too slow a take, a skeleton without known feet, no jump, no held frame. `effective_fps` is the estimated
    framerate of the capture, at most the file's. All values are finite.
    """

    max_joint_speed: float
    num_teleports: int
    first_teleport_seconds: float | None
    jitter: float | None
    frozen_seconds: float
    frozen_start_seconds: float | None
    held_share: float
    foot_skate: float | None
    foot_skate_share: float | None
    floor_height: float
    bone_length_drift: float | None
    effective_fps: float | None
    flags: tuple[str, ...]


def measure(motion: Motion) -> Quality:
    """Measure a motion whose numbers are finite: a pure function of its frames, framerate and skeleton.

    Flags: `single_frame`, `joint_speed`, `teleport`, `jitter`, `frozen`, `foot_skate`, `floor_height`, `bone_length`,
    `lying`, `upsampled`.
    """
    motion = _bounded(motion)
    positions, fps = motion.joint_positions, float(motion.fps)
    squared = squared_differences(positions, 1)
    steps = measure_steps(squared, fps)
    noise = jitter(positions, fps)
    skate = foot_skate(motion)
    floor = float(positions[..., 1].min())
    drift = bone_length_drift(positions, motion.skeleton, fps)
    elevation = head_elevation(positions, motion.skeleton, fps)
    captured = effective_fps(positions, longest_steps(squared), fps)
    odd = {
        "single_frame": motion.num_frames == 1,
        "joint_speed": steps.max_speed > MAX_JOINT_SPEED,
        "teleport": steps.num_jumps > 0,
        "jitter": noise is not None and noise > MAX_JITTER,
        "frozen": steps.frozen_seconds >= MAX_FROZEN_SECONDS,
        "foot_skate": skate is not None and skate.share > MAX_FOOT_SKATE_SHARE,
        "floor_height": abs(floor) > MAX_FLOOR_HEIGHT,
        "bone_length": drift is not None and drift > MAX_BONE_LENGTH_DRIFT,
        "lying": elevation is not None and elevation < MAX_LYING_ELEVATION,
        "upsampled": captured is not None and captured < fps,
    }
    return Quality(
        max_joint_speed=steps.max_speed,
        num_teleports=steps.num_jumps,
        first_teleport_seconds=steps.first_jump_seconds,
        jitter=noise,
        frozen_seconds=steps.frozen_seconds,
        frozen_start_seconds=steps.frozen_start_seconds,
        held_share=steps.held_share,
        foot_skate=None if skate is None else skate.speed,
        foot_skate_share=None if skate is None else skate.share,
        floor_height=floor,
        bone_length_drift=drift,
        effective_fps=captured,
        flags=tuple(flag for flag, holds in odd.items() if holds),
    )


def _bounded(motion: Motion) -> Motion:
    positions = motion.joint_positions
    if positions.min() >= -FAR_METRES and positions.max() <= FAR_METRES:
        return motion
    return replace(motion, joint_positions=np.clip(positions, -FAR_METRES, FAR_METRES, dtype=np.float32))
