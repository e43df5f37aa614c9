"""A take: one motion as a page shows it, at its own framerate, with what is to be said of it."""

from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float32, Float64

from motionkit.motion import Caption, Motion
from motionkit.skeleton import Skeleton
from motionkit.timegrid import TimeGrid, format_fps

Colours = Literal["sides", "given", "plain"]


@dataclass(frozen=True, eq=False)
class Take:
    """Joint positions [T, J, 3] in metres, y up; frame k is at `start_seconds` + k / `fps`, or at `uneven_seconds`[k].

    Frames are counted from `first_frame`, where a take is a stretch of a file. `seen` says which frames hold what was
    observed: the others are drawn otherwise, and called `unseen`. Bones have the colours of left and right ("sides"),
    those of frames that were given and made ("given"), or one ("plain"). `labels` are said below the name, `details`
    are pairs of what and its value.
    """

    name: str
    joint_positions: Float32[np.ndarray, "frames joints 3"]
    skeleton: Skeleton
    fps: Fraction
    start_seconds: float = 0.0
    first_frame: int = 0
    uneven_seconds: Float64[np.ndarray, "frames"] | None = None
    seen: Bool[np.ndarray, "frames"] | None = None
    unseen: str = "lost"
    colours: Colours = "sides"
    captions: tuple[Caption, ...] = ()
    labels: tuple[str, ...] = ()
    details: tuple[tuple[str, str], ...] = field(default=())

    @property
    def num_frames(self) -> int:
        """Number of frames T."""
        return len(self.joint_positions)

    @property
    def duration_seconds(self) -> float:
        """How long its frames are shown: T / fps; of uneven ones to the last, and for 1 / fps more."""
        if self.uneven_seconds is None:
            return float(self.num_frames / self.fps)
        return float(self.uneven_seconds[-1] - self.uneven_seconds[0] + 1 / self.fps)

    def frame_seconds(self) -> Float64[np.ndarray, "frames"]:
        """When its frames are, in seconds."""
        if self.uneven_seconds is not None:
            return self.uneven_seconds
        return TimeGrid(self.fps, self.num_frames, self.start_seconds).seconds()

    def frames(self, start: int, stop: int) -> "Take":
        """Frames [start, stop), counted from its own first, at their own times."""
        return replace(
            self,
            joint_positions=self.joint_positions[start:stop],
            start_seconds=float(self.frame_seconds()[start]),
            first_frame=self.first_frame + start,
            uneven_seconds=None if self.uneven_seconds is None else self.uneven_seconds[start:stop],
            seen=None if self.seen is None else self.seen[start:stop],
        )


def take_of(motion: Motion, name: str) -> Take:
    """A motion as a take, with its captions, labels, and where it comes from."""
    known = motion.provenance
    labels = [motion.action, motion.style, known.subject and f"subject {known.subject}", motion.split]
    rotations = "with rotations" if motion.local_rotations is not None else "positions only"
    details = {
        "skeleton": f"{motion.skeleton.name or 'unnamed'}, {motion.skeleton.num_joints} joints, {rotations}",
        "framerate": f"{format_fps(motion.fps)} fps",
        "the file says": known.stated_fps,
        "format": known.source_format,
        "source": "/".join(part for part in (known.source, known.source_path) if part),
        "licence": known.licence,
        "operations": "; ".join(known.operations),
    }
    return Take(
        name=name,
        joint_positions=motion.joint_positions,
        skeleton=motion.skeleton,
        fps=motion.fps,
        start_seconds=motion.timegrid.start_seconds,
        captions=motion.captions,
        labels=tuple(dict.fromkeys(label for label in labels if label)),
        details=tuple((what, value) for what, value in details.items() if value),
    )
