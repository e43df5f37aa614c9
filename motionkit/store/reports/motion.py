"""What one motion of a file is: its clock, its body, its unit and axes, and what looks odd."""

from dataclasses import dataclass

from motionkit.core.framerate import format_fps
from motionkit.core.motion import Motion
from motionkit.core.skeletons.mapping import SkeletonMapError
from motionkit.features.quality import measure
from motionkit.io.body_frame import logged_unit, logged_up, standing_metres


@dataclass(frozen=True)
class MotionSummary:
    """A motion in memory and the file that it comes from.

    `fps` is exact (30000/1001) and `stated_fps` what the file says; `fps` and `duration_seconds` are None if nothing
    says a framerate. `height_metres` is the length from the ankles along the bones to the base of the skull, None for
    joints that are not mapped to the 22. `unit_metres` and `up` are the file's; the motion is in metres, y up.
    """

    sequence_id: str
    format: str
    fps: str | None
    stated_fps: str
    num_frames: int
    duration_seconds: float | None
    height_metres: float | None
    unit_metres: float
    unit: str
    up: str
    skeleton: str
    num_joints: int
    has_rotations: bool
    num_captions: int
    quality_flags: tuple[str, ...]
    operations: tuple[str, ...]


def summarise_motion(motion: Motion, *, has_framerate: bool = True) -> MotionSummary:
    """Describe a motion as its reader returned it."""
    source = motion.provenance
    unit_metres, unit = logged_unit(source.operations)
    try:
        height = standing_metres(motion.skeleton, motion.joint_positions)
    except SkeletonMapError:
        height = None
    return MotionSummary(
        sequence_id=motion.sequence_id,
        format=source.source_format,
        fps=format_fps(motion.fps) if has_framerate else None,
        stated_fps=source.stated_fps,
        num_frames=motion.num_frames,
        duration_seconds=motion.duration_seconds if has_framerate else None,
        height_metres=height,
        unit_metres=unit_metres,
        unit=unit,
        up=logged_up(source.operations),
        skeleton=motion.skeleton.name,
        num_joints=motion.skeleton.num_joints,
        has_rotations=motion.local_rotations is not None,
        num_captions=len(motion.captions),
        quality_flags=measure(motion).flags if has_framerate else (),
        operations=source.operations,
    )
