"""Motion: joint positions with their clock, skeleton, captions and history.

Right-handed, y up, metres, float32; quaternions are (w, x, y, z). Nothing here resamples.
"""

from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

import motionkit
from motionkit.core.errors import counted
from motionkit.core.shapes import Float, Float32, Int
from motionkit.core.skeleton import STANDARD_SKELETONS, Skeleton
from motionkit.core.timegrid import SAME_SECONDS, Framerate, TimeGrid, parse_fps


@dataclass(frozen=True)
class Caption:
    """A sentence about [start_seconds, end_seconds) of a motion; `end_seconds` None means to the end.

    `tokens` is HumanML3D's `word/POS word/POS …` line if the source has one, else empty.

    >>> mk.Caption("a person waves", 1.5, 3.0).end_seconds
    3.0
    """

    text: str
    start_seconds: float = 0.0
    end_seconds: float | None = None
    tokens: str = ""


@dataclass(frozen=True)
class Provenance:
    """A motion's origin and processing history.

    `stated_fps` is the framerate stated in the file, verbatim (empty if none); `operations` is the log, oldest first.
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
    """A sequence of poses with its time grid and skeleton.

    `joint_positions` [T, J, 3] metres float32; `local_rotations` [T, J, 4] unit quaternions relative to the parent, and
    `root_translation` [T, 3] metres, if the source has true ones. Raises `ValueError` if shapes disagree with the time
    grid or the skeleton. Notebooks display a motion as a moving skeleton.

    >>> motion = mk.read("walk.bvh")
    >>> motion.fps, motion.num_frames, motion.duration_seconds
    (Fraction(60, 1), 240, 4.0)
    >>> motion.joint_positions.shape
    (240, 22, 3)
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

    @classmethod
    def from_joints(
        cls,
        joint_positions: Float[np.ndarray, "frames joints 3"],
        fps: Framerate,
        skeleton: Skeleton | None = None,
        *,
        unit_metres: float = 1.0,
    ) -> "Motion":
        """A motion of bare joint positions [T, J, 3], y up, in units of `unit_metres`; frame 0 is at 0 s.

        22 joints are SMPL's (HumanML3D's) and 21 are KIT-ML's unless a skeleton is given. Raises `TypeError` for
        anything but an array of numbers; `ValueError` for another shape, another number of joints without a skeleton,
        positions that are not finite or, in metres, of no person's size, and for a framerate that is not positive.

        >>> mk.Motion.from_joints(np.zeros((100, 22, 3)), fps=59.94)
        Motion('', 100 frames at 60000/1001 fps = 1.67 s, smpl22 (22 joints), positions only, 0 captions)
        """
        _check_joints(joint_positions, unit_metres)
        num_frames, num_joints, _ = joint_positions.shape
        if skeleton is None:
            skeleton = next((each for each in STANDARD_SKELETONS.values() if each.num_joints == num_joints), None)
        if skeleton is None:
            raise ValueError(f"{num_joints} joints, expected 22 (SMPL's) or 21 (KIT-ML's): else give their skeleton")
        metres = (joint_positions * unit_metres).astype(np.float32)
        return cls(metres, skeleton, TimeGrid(parse_fps(fps), num_frames))

    @property
    def fps(self) -> Fraction:
        """Framerate, exact."""
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
        """Frames [start, stop) with their own time stamps; captions are unchanged."""
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

    def __getitem__(self, seconds: slice) -> "Motion":
        """The frames of [start, stop) in seconds; a part keeps its time stamps.

        Captions are cut to the part, and those of other parts dropped. Raises `ValueError` for negative seconds and
        seconds without a frame, `TypeError` for anything but `motion[start:stop]`; `frames` slices by frame indices.

        >>> part = mk.read("walk.bvh")[1.5:2.0]
        >>> part.num_frames, part.timegrid.start_seconds
        (30, 1.5)
        """
        if not isinstance(seconds, slice) or seconds.step is not None:
            raise TypeError("a motion is cut by seconds, motion[1.5:2.0]; motion.frames(90, 120) cuts by frames")
        begin = -np.inf if seconds.start is None else float(seconds.start)
        end = np.inf if seconds.stop is None else float(seconds.stop)
        times = self.timegrid.seconds()
        if not all(each >= min(0.0, times[0]) for each in (seconds.start, seconds.stop) if each is not None):
            raise ValueError(
                f"seconds are counted from the start, not from the end, and are not {seconds.start} to {seconds.stop}; "
                f"this motion ends at {self.timegrid.start_seconds + self.duration_seconds:g} s"
            )
        start, stop = np.searchsorted(times, (begin - SAME_SECONDS, end - SAME_SECONDS)).tolist()
        if start >= stop:
            raise ValueError(
                f"no frame lies in [{begin:g}, {end:g}) s: the motion's are at {times[0]:g} to {times[-1]:.6g} s"
            )
        part = self.frames(start, stop)
        return replace(part, captions=captions_within(self.captions, part.timegrid))

    def resample(self, fps: Framerate) -> "Motion":
        """The motion at any framerate, as `motionkit.fields.resample` makes it.

        >>> mk.read("walk.bvh").resample(23.976).fps
        Fraction(24000, 1001)
        """
        return motionkit.resample(self, fps)

    def save(self, path: str | Path) -> None:
        """Write the motion to a file in the format of its suffix, as `motionkit.write` does.

        >>> mk.read("walk.bvh").save("walk.glb")
        """
        motionkit.write(self, path)

    def _repr_html_(self) -> str:
        """The moving skeleton, for notebooks."""
        return motionkit.notebook_view(self)

    def annotated_like(self, source: "Motion") -> "Motion":
        """The same frames with the captions, labels, id and provenance of another motion."""
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
            f"{self.skeleton.name} ({self.skeleton.num_joints} joints), {rotations}, "
            f"{counted(len(self.captions), 'caption')})"
        )


# Units in which a person is of these sizes, and what they are called.
_UNITS = {"metres": 1.0, "inches": 0.0254, "centimetres": 0.01, "millimetres": 0.001}
# The longest side of a typical pose's bounding box.
_PERSON_METRES = 1.6


def _check_joints(joint_positions: object, unit_metres: float) -> None:
    """Raises what `Motion.from_joints` raises for an array."""
    if not isinstance(joint_positions, np.ndarray) or joint_positions.dtype.kind not in "fiu":
        kind = f"{type(joint_positions).__module__}.{type(joint_positions).__qualname__}".removeprefix("builtins.")
        of = f" of {joint_positions.dtype}" if isinstance(joint_positions, np.ndarray) else ""
        raise TypeError(f"joint_positions are a {kind}{of}, expected a numpy array of numbers [frames, joints, 3]")
    shape = joint_positions.shape
    if len(shape) != 3 or shape[2] != 3 or not all(shape):
        raise ValueError(f"joint_positions have the shape {shape}, expected [frames, joints, 3] and at least one frame")
    if not 0 < unit_metres < np.inf:
        raise ValueError(f"unit_metres is {unit_metres}, expected the length of a unit in metres, such as 0.001")
    if not np.isfinite(joint_positions).all():
        frame, joint, _ = np.argwhere(~np.isfinite(joint_positions))[0].tolist()
        raise ValueError(
            f"joint_positions are not finite in frame {frame}, joint {joint}: expected numbers in all frames"
        )
    size = float(np.median(np.ptp(joint_positions, axis=1).max(axis=1)))
    name, unit = min(
        _UNITS.items(), key=lambda each: abs(np.log(max(size * unit_metres, 1e-9) * each[1] / _PERSON_METRES))
    )
    if unit < 1.0 and size * unit_metres > 1.0:
        raise ValueError(
            f"a body of {size * unit_metres:.4g} m: these look like {name}; divide by {1 / unit:g} or pass "
            f"unit_metres={unit_metres * unit:g}"
        )


def captions_within(captions: tuple[Caption, ...], grid: TimeGrid) -> tuple[Caption, ...]:
    """The captions that overlap a time grid, clipped to it; a caption of all of it is unchanged."""
    begin, end = grid.start_seconds, grid.start_seconds + grid.duration_seconds
    kept = []
    for caption in captions:
        first, last = caption.start_seconds, caption.end_seconds
        if first >= end - SAME_SECONDS or (last is not None and last <= begin + SAME_SECONDS):
            continue
        if (first, last) != (0.0, None):
            last = None if last is None or last >= end - SAME_SECONDS else last
            caption = replace(caption, start_seconds=max(first, begin), end_seconds=last)
        kept.append(caption)
    return tuple(kept)


FLIP = np.array([-1.0, 1.0, 1.0], dtype=np.float32)
# The reflection M = diag(−1, 1, 1) turns a rotation R into M·R·M, which turns the other way about y and z.
TURN_BACK = np.array([1.0, 1.0, -1.0, -1.0], dtype=np.float32)


def mirror(motion: Motion) -> Motion:
    """The mirror image in the plane x = 0, with left and right joints exchanged; captions are unchanged.

    Rotations come with a mirrored skeleton, so that forward kinematics gives the mirrored positions exactly, also for a
    body that is not symmetric. Raises `ValueError` for a skeleton without left/right pairs, or whose pairs hang from
    joints that are not a pair. Source of the rule: HumanML3D, raw_pose_processing.ipynb (`swap_left_right`).
    """
    order = _partners(motion.skeleton)
    rotations, root = motion.local_rotations, motion.root_translation
    mirrored = replace(
        motion,
        joint_positions=mirror_positions(motion.joint_positions, motion.skeleton.left_right_pairs),
        skeleton=motion.skeleton if rotations is None else _mirrored_skeleton(motion.skeleton, order),
        local_rotations=None if rotations is None else rotations[:, order] * TURN_BACK,
        root_translation=None if root is None else root * FLIP,
    )
    return mirrored.logged("mirrored: x ← −x, left and right joints exchanged")


def mirror_positions(
    joint_positions: Float[np.ndarray, "*poses joints 3"], left_right_pairs: tuple[tuple[int, int], ...]
) -> Float[np.ndarray, "*poses joints 3"]:
    """The mirror image of joint positions alone, of any number of poses."""
    return joint_positions[..., exchanged(joint_positions.shape[-2], left_right_pairs), :] * FLIP


def _partners(skeleton: Skeleton) -> Int[np.ndarray, "joints"]:
    if not skeleton.left_right_pairs:
        raise ValueError(f"skeleton {skeleton.name!r} does not say which joints are left and right")
    order = exchanged(skeleton.num_joints, skeleton.left_right_pairs)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0 and skeleton.parents[order[joint]] != order[parent]:
            names = skeleton.joint_names[joint], skeleton.joint_names[order[joint]]
            raise ValueError(f"skeleton {skeleton.name!r}: {names[0]} and {names[1]} hang from joints that are no pair")
    return order


def exchanged(num_joints: int, left_right_pairs: tuple[tuple[int, int], ...]) -> Int[np.ndarray, "joints"]:
    """The joints in the order in which left and right are exchanged."""
    order = np.arange(num_joints)
    for left, right in left_right_pairs:
        order[left], order[right] = right, left
    return order


def _mirrored_skeleton(skeleton: Skeleton, order: Int[np.ndarray, "joints"]) -> Skeleton:
    sites = {int(order[joint]): (-x + 0.0, y, z) for joint, (x, y, z) in skeleton.end_sites}
    # − 0 + 0 = 0: a symmetric skeleton is its own mirror image to the bit.
    return replace(
        skeleton,
        offsets=skeleton.offsets[order] * FLIP + np.float32(0.0),
        end_sites=tuple(sorted(sites.items())),
    )
