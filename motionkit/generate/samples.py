"""Generated motions as poses: their fields sampled at a framerate, or at arbitrary instants."""

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption, Motion
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import MotionField, at_fps
from motionkit.generate.constraints import Followed, followed
from motionkit.generate.long_motions import Script, captions_of, constraints_of

SLUG_LENGTH = 40


@dataclass(frozen=True, eq=False)
class GeneratedSample:
    """Poses of one generated motion: uniformly at `fps`, or at arbitrary `seconds` if `fps` is None."""

    name: str
    joint_positions: Float32[np.ndarray, "frames joints 3"]
    seconds: Float64[np.ndarray, "frames"]
    fps: Fraction | None
    duration_seconds: float
    skeleton: Skeleton
    captions: tuple[Caption, ...]
    action: str
    followed: tuple[Followed, ...] = ()

    def plain(self, file: str) -> dict[str, Any]:
        """A summary with the file's path, as JSON."""
        return {
            "file": file,
            "caption": self.captions[0].text if len(self.captions) == 1 else "",
            "captions": [
                {"text": caption.text, "start_seconds": caption.start_seconds, "end_seconds": caption.end_seconds}
                for caption in self.captions
            ],
            "action": self.action,
            "duration_seconds": self.duration_seconds,
            "fps": None if self.fps is None else str(self.fps),
            "num_frames": len(self.seconds),
        } | ({"constraints": [each.plain() for each in self.followed]} if self.followed else {})

    def motion(self) -> Motion:
        """The poses as a motion; raises `UsageError` for poses without a uniform framerate."""
        if self.fps is None:
            raise UsageError("poses at arbitrary instants have no framerate: write them as npz")
        grid = TimeGrid(self.fps, len(self.seconds), float(self.seconds[0]))
        return Motion(
            self.joint_positions,
            self.skeleton,
            grid,
            captions=self.captions,
            action=self.action,
            sequence_id=self.name,
        )


def sample_field(
    field: MotionField,
    name: str,
    script: Script,
    fps: Fraction,
    times_seconds: Float64[np.ndarray, "times"] | None = None,
) -> GeneratedSample:
    """Sample a generated field: at `times_seconds`, or the frames k / fps of the half-open interval it lasts.

    Four seconds at 20 fps are 80 frames; `to_motion` would include the frame at the closed end too.
    """
    duration = field.end_seconds - field.start_seconds
    if times_seconds is None:
        field = at_fps(field, fps)
        num_frames = max(1, int(np.ceil(duration * float(fps) - 1e-6)))
        seconds = TimeGrid(fps, num_frames, field.start_seconds).seconds()
    else:
        seconds = times_seconds
    return GeneratedSample(
        name=name,
        joint_positions=field.query(seconds).joint_positions,
        seconds=seconds,
        fps=fps if times_seconds is None else None,
        duration_seconds=duration,
        skeleton=field.skeleton,
        captions=captions_of(script),
        action=script[0].action if len({request.action for request in script}) == 1 else "",
        followed=tuple(followed(field, each) for each in constraints_of(script)),
    )


def standing(field: MotionField, script: Script) -> MotionField:
    """A generated field without foot sliding, with fixed bone lengths (`motionkit.fields.contact`).

    Joints constrained in the world stay in place. Returns the field unchanged, with a warning, if the skeleton's legs
    are unknown.
    """
    is_placed = any(each.frame == "world" for request in script for each in request.constraints)
    try:
        return planted(field, "kept" if is_placed else "free")
    except SkeletonMapError as error:
        warn(f"not planted: {error}")
        return field


def motion_name(index: int, script: Script) -> str:
    """A descriptive file name for the index-th motion: `0003-a-person-walks`."""
    asked = " ".join(request.text or request.action for request in script).strip() or "unconditional"
    slug = re.sub(r"[^a-z0-9]+", "-", asked.lower()).strip("-")
    return f"{index:04d}-{slug[:SLUG_LENGTH].strip('-') or 'motion'}"
