"""Motion: joint positions with their clock, skeleton, captions and history.

Right-handed, y up, metres, float32; quaternions are (w, x, y, z). Nothing here resamples.
"""

from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np
from jaxtyping import Float32

from motionkit.skeleton import Skeleton
from motionkit.timegrid import TimeGrid


@dataclass(frozen=True)
class Caption:
    """A sentence about [start_seconds, end_seconds) of a motion; `end_seconds` None means to the end.

    `tokens` is HumanML3D's `word/POS word/POS …` line where the source has one, else empty.
    """

    text: str
    start_seconds: float = 0.0
    end_seconds: float | None = None
    tokens: str = ""


@dataclass(frozen=True)
class Provenance:
    """Where a motion comes from and what was done to it.

    `stated_fps` is what the file says, verbatim (empty where it says nothing); `operations` is the log, oldest first.
    """

    source: str = ""
    subset: str = ""
    source_path: str = ""
    source_sha256: str = ""
    source_format: str = ""
    licence: str = ""
    subject: str = ""
    stated_fps: str = ""
    operations: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Motion:
    """One sequence of poses that never travels without its clock.

    `joint_positions` [T, J, 3] metres float32; `local_rotations` [T, J, 4] unit quaternions relative to the parent, and
    `root_translation` [T, 3] metres, where the source has true ones. Raises `ValueError` where shapes disagree with the
    time grid or the skeleton.
    """

    joint_positions: Float32[np.ndarray, "frames joints 3"]
    skeleton: Skeleton
    timegrid: TimeGrid
    local_rotations: Float32[np.ndarray, "frames joints 4"] | None = None
    root_translation: Float32[np.ndarray, "frames 3"] | None = None
    captions: tuple[Caption, ...] = ()
    action: str = ""
    style: str = ""
    split: str = ""
    sequence_id: str = ""
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        expected = (self.timegrid.num_frames, self.skeleton.num_joints)
        if self.joint_positions.shape[:2] != expected:
            raise ValueError(
                f"joint_positions are {self.joint_positions.shape}, but the time grid and the skeleton say {expected}"
            )
        if self.local_rotations is not None and self.local_rotations.shape[:2] != expected:
            raise ValueError(f"local_rotations are {self.local_rotations.shape}, expected {(*expected, 4)}")
        if self.root_translation is not None and self.root_translation.shape[0] != expected[0]:
            raise ValueError(f"root_translation is {self.root_translation.shape}, expected {(expected[0], 3)}")

    @property
    def fps(self) -> Fraction:
        """Framerate."""
        return self.timegrid.fps

    @property
    def num_frames(self) -> int:
        """Number of frames T."""
        return self.timegrid.num_frames

    @property
    def duration_seconds(self) -> float:
        """num_frames / fps."""
        return self.timegrid.duration_seconds

    def frames(self, start: int, stop: int) -> "Motion":
        """Frames [start, stop) with their own time stamps; captions are kept as they are."""
        if not 0 <= start < stop <= self.num_frames:
            raise ValueError(f"frames [{start}, {stop}) do not lie inside the motion's {self.num_frames}")
        grid = TimeGrid(self.fps, stop - start, self.timegrid.start_seconds + float(start / self.fps))
        return replace(
            self,
            joint_positions=self.joint_positions[start:stop],
            timegrid=grid,
            local_rotations=None if self.local_rotations is None else self.local_rotations[start:stop],
            root_translation=None if self.root_translation is None else self.root_translation[start:stop],
        )

    def annotated_like(self, source: "Motion") -> "Motion":
        """The same frames with the captions, labels, id and provenance of the motion they were made of."""
        return replace(
            self,
            captions=source.captions,
            action=source.action,
            style=source.style,
            split=source.split,
            sequence_id=source.sequence_id,
            provenance=source.provenance,
        )

    def logged(self, operation: str) -> "Motion":
        """The same motion with one more line in its operation log."""
        provenance = replace(self.provenance, operations=(*self.provenance.operations, operation))
        return replace(self, provenance=provenance)

    def __repr__(self) -> str:
        rotations = "rotations" if self.local_rotations is not None else "positions only"
        return (
            f"Motion({self.sequence_id!r}, {self.num_frames} frames at {self.fps} fps = {self.duration_seconds:.2f} s, "
            f"{self.skeleton.name} ({self.skeleton.num_joints} joints), {rotations}, {len(self.captions)} captions)"
        )
