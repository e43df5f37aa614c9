"""A take: one motion for display, at its own framerate, with drawing information, packed into a string."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Literal, TypedDict

import numpy as np

from motionkit.core.framerate import format_fps
from motionkit.core.motion import Caption, Motion
from motionkit.core.shapes import Bool, Float32, Float64, Int
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.transfer import counterpart_joints
from motionkit.io.gltf import joint_sides

Colours = Literal["sides", "given", "plain"]
Line = Float64[np.ndarray, "_ 3"]


@dataclass(frozen=True, eq=False)
class Take:
    """Joint positions [T, J, 3] in metres, y up; frame k is at `start_seconds` + k / `fps`, or at `uneven_seconds`[k].

    `first_frame` is the offset of a take that is a stretch of a file. `seen` masks observed frames; others are drawn
    differently, and labelled `unseen`. Bones are coloured by side ("sides"), by given and new frames ("given"), or
    uniformly ("plain"). `labels` are shown below the name, `details` are key-value pairs. `lines` are drawn in the
    motion's world, on the floor where a height is NaN.
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
    lines: tuple[Line, ...] = ()

    @property
    def num_frames(self) -> int:
        """Number of frames T."""
        return len(self.joint_positions)

    @property
    def duration_seconds(self) -> float:
        """Display duration: T / fps; for uneven times until the last, plus 1 / fps."""
        if self.uneven_seconds is None:
            return float(self.num_frames / self.fps)
        return float(self.uneven_seconds[-1] - self.uneven_seconds[0] + 1 / self.fps)

    def frame_seconds(self) -> Float64[np.ndarray, "frames"]:
        """Times of its frames in seconds."""
        if self.uneven_seconds is not None:
            return self.uneven_seconds
        return TimeGrid(self.fps, self.num_frames, self.start_seconds).seconds()

    def frames(self, start: int, stop: int) -> "Take":
        """Frames [start, stop), relative to its first, with their own times."""
        return replace(
            self,
            joint_positions=self.joint_positions[start:stop],
            start_seconds=float(self.frame_seconds()[start]),
            first_frame=self.first_frame + start,
            uneven_seconds=None if self.uneven_seconds is None else self.uneven_seconds[start:stop],
            seen=None if self.seen is None else self.seen[start:stop],
        )


def take_of(motion: Motion, name: str) -> Take:
    """A motion as a take, with its captions, labels and provenance."""
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


# A joint whose distance from its parent changes by so much hangs on no bone: from the root (hips above a reference on
# the floor), and from any other joint, where a generated limb's length may well change by a decimetre.
TRAVELLING_FROM_ROOT_METRES, TRAVELLING_METRES = 0.1, 0.5
# Of feet without toes the ankles.
ENDS = (("left_foot", "left_ankle"), ("right_foot", "right_ankle"), ("left_wrist",), ("right_wrist",))
# Where no table knows a skeleton, the ends of its limbs are traced, of a few.
MOST_ENDS = 8


@dataclass(frozen=True)
class Drawing:
    """For each joint the parent of its bone (-1: none) and its side (-1 left, 0, 1 right).

    `head` is the head joint, -1 if unknown. `ends` are feet and hands. `yaw` is the facing direction in the first
    frame: the angle about Y, in radians, from Z+ towards X+.
    """

    bones: tuple[int, ...]
    sides: tuple[int, ...]
    head: int
    ends: tuple[int, ...]
    yaw: float


def drawing_of(skeleton: Skeleton, positions: Float32[np.ndarray, "frames joints 3"]) -> Drawing:
    """How a skeleton with these positions in metres is drawn; markers without bones are points."""
    try:
        own = {SMPL22.joint_names[joint]: source for joint, source in counterpart_joints(skeleton).items()}
    except SkeletonMapError:
        own = {}
    bones = _bones(skeleton, positions)
    ends = [next(own[name] for name in names if name in own) for names in ENDS if own.keys() & set(names)]
    ends = ends or _leaves(bones)[:MOST_ENDS]
    return Drawing(bones, joint_sides(skeleton), own.get("head", -1), tuple(dict.fromkeys(ends)), _yaw(own, positions))


def _bones(skeleton: Skeleton, positions: Float32[np.ndarray, "frames joints 3"]) -> tuple[int, ...]:
    parents = list(skeleton.parents)
    lengths = np.linalg.norm(positions - positions[:, skeleton.parents_or_self], axis=-1)
    limits = [TRAVELLING_FROM_ROOT_METRES if parent == 0 else TRAVELLING_METRES for parent in parents]
    travels = np.ptp(lengths, axis=0) > limits
    bones = [-1 if far else parent for parent, far in zip(parents, travels.tolist(), strict=True)]
    # Markers have the first of them for their parent, and no rest pose.
    loose = not skeleton.offsets.any() and skeleton.num_joints > 1 and all(parent <= 0 for parent in parents)
    return tuple([-1] * len(bones) if loose else bones)


def _leaves(bones: tuple[int, ...]) -> list[int]:
    return [joint for joint, parent in enumerate(bones) if parent >= 0 and joint not in bones]


def _yaw(own: dict[str, int], positions: Float32[np.ndarray, "frames joints 3"]) -> float:
    if "left_hip" not in own or "right_hip" not in own:
        return 0.0
    across = positions[0, own["left_hip"]] - positions[0, own["right_hip"]]
    # Left is at X+ of a body that faces Z+.
    return float(np.arctan2(-across[2], across[0]))


STEP_METRES = 1e-4
_NARROW = 2**15 - 1
# Beyond this a grid point does not fit into 32 bits.
FARTHEST_METRES = 2e5


class Packed(TypedDict):
    """What a page holds of positions: int16 [T, narrow joints, 3] and int32 [T, wide joints, 3], base64."""

    step: float
    parents: list[int]
    wide: list[int]
    narrowNumbers: str
    wideNumbers: str


def packed_bytes(num_frames: int, num_joints: int) -> int:
    """Estimated size of positions in a page: the root wide, all other joints narrow, as text."""
    return num_frames * (num_joints + 1) * 3 * 2 * 4 // 3


def pack(positions: Float32[np.ndarray, "frames joints 3"], parents: Sequence[int]) -> Packed:
    """Positions in metres as text; raises `ValueError` for a joint that is not finite or 200 km from the origin."""
    # A comparison with nan is false.
    if not bool(np.all(np.abs(positions) < FARTHEST_METRES)):
        raise ValueError(f"a joint is not within {FARTHEST_METRES:g} m of the origin")
    points = np.rint(positions.astype(np.float64) / STEP_METRES).astype(np.int32)
    steps: Int[np.ndarray, "frames joints 3"] = points.copy()
    children = [joint for joint, parent in enumerate(parents) if parent >= 0]
    steps[:, children] -= points[:, [parents[joint] for joint in children]]
    far = np.abs(steps).max(axis=(0, 2)) > _NARROW
    far[0] = True
    return Packed(
        step=STEP_METRES,
        parents=list(parents),
        wide=np.flatnonzero(far).tolist(),
        narrowNumbers=_text(steps[:, ~far].astype("<i2")),
        wideNumbers=_text(steps[:, far].astype("<i4")),
    )


def _text(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
