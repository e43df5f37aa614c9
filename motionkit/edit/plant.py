"""Planting a motion: its feet stop sliding, and the change is measured (docs/plant.md)."""

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from motionkit.core.errors import counted
from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Float64
from motionkit.core.timegrid import runs
from motionkit.edit.motions import EditedMotion, LoadedMotion, load_motion, write_as_loaded
from motionkit.fields.contact.planted import Path as BodyPath
from motionkit.fields.contact.planted import Planting, planted_frames
from motionkit.io.bvh import KnownFrames

MOVED_METRES = 2e-5
# Smaller changes are not worth a word.
SMALL_METRES = 0.001


def plant(motion: Motion | str | Path, *, path: BodyPath = "near") -> Motion:
    """Remove foot sliding: the body is moved and the legs are bent; bones keep their length.

    - `motion`: a motion, or a file; its legs are recognised by joint names (docs/formats.md)
    - `path`: "near" the body's original path; or "free", determined by its feet, for generated motion

    Real feet roll, pivot and creep: contacts that are not faster than that are unchanged (docs/plant.md). Raises
    `MotionkitError` for frames that hold nan and for a skeleton with unknown legs.

    >>> motion = mk.read("walk.bvh")
    >>> mk.plant(motion).num_frames
    240
    """
    return planted_motion(load_motion(motion), path).motion


@dataclass(frozen=True)
class Change:
    """Changes of a motion in m and m/s; speeds are None for feet without contact.

    `sliding` is the mean horizontal speed of feet in contact, weighted towards the steadier of ankle and toe.
    `largest_level_shift` and `largest_height_shift` are how far the correction moves a foot along the ground, and up or
    down to it; `has_fixed_bones` is whether positions without rotations were projected onto bones of constant length.
    """

    num_contacts: int
    sliding_before: float | None
    sliding_after: float | None
    largest_level_shift: float
    largest_height_shift: float
    has_fixed_bones: bool
    largest_change: float
    mean_change: float

    def __str__(self) -> str:
        if self.sliding_before is None or self.sliding_after is None:
            described = "no foot is on the ground"
        elif self.largest_level_shift < SMALL_METRES:
            described = f"feet slide no more than captures do ({100 * self.sliding_before:.1f} cm/s): left alone"
        else:
            described = (
                f"{counted(self.num_contacts, 'contact')} slid at {100 * self.sliding_before:.1f} cm/s, now "
                f"{100 * self.sliding_after:.1f}"
            )
        if self.largest_height_shift >= SMALL_METRES:
            described += f"; feet were up to {1000 * self.largest_height_shift:.0f} mm above or below the ground"
        if self.has_fixed_bones:
            described += "; bones changed their length"
        if self.largest_change >= SMALL_METRES:
            described += f"; joints moved by up to {1000 * self.largest_change:.0f} mm"
        return described


def planted_motion(loaded: LoadedMotion, path: BodyPath) -> EditedMotion:
    """The motion with planted feet; frames that nothing moves are unchanged.

    Raises `MotionkitError` for frames that hold nan or are uneven in time.
    """
    loaded.check_complete()
    motion, seconds = loaded.motion, loaded.seconds
    planting = planted_frames(loaded.observation(loaded.valid), motion.timegrid, path)
    change, moved = measure_change(planting, seconds)
    poses, unmoved = loaded.poses.copy(), np.flatnonzero(~moved)
    if moved.any():
        poses.put(moved, planting(seconds[moved]))
    line = (
        f"plant {counted(change.num_contacts, 'contact')}, the body's path {path}: joints moved by up to "
        f"{1000 * change.largest_change:.1f} mm"
    )
    planted = poses.at(motion.timegrid, motion.skeleton).annotated_like(motion).logged(line)
    known = KnownFrames(np.arange(len(moved)), seconds, unmoved, unmoved)
    details = {"fps": str(motion.fps), "num_frames": motion.num_frames, **asdict(change), "note": loaded.note}
    return EditedMotion(planted, partial(write_as_loaded, loaded, planted, known), details, remark=str(change))


def measure_change(
    planting: Planting, times: Float64[np.ndarray, "frames"]
) -> tuple[Change, Bool[np.ndarray, "frames"]]:
    """Measure what planting changes at these ascending times, and which frames it moves."""
    before, after = planting.field.query(times).joint_positions, planting(times).joint_positions
    correction = planting.correction
    distance = np.linalg.norm(after - before, axis=-1)
    contacts, fps = correction.contacts, correction.fps
    feet = correction.offsets[:, :1] + correction.offsets[:, 1:]
    down = np.asarray(contacts.down.any(axis=-1))
    sliding: list[float | None] = [None, None]
    if down.any():
        velocities = (contacts.velocity, contacts.velocity + np.gradient(feet, axis=0) * fps)
        sliding = [float(np.hypot(each[..., 0], each[..., 2])[down].mean()) for each in velocities]
    moved = distance.max(axis=1) > MOVED_METRES
    change = Change(
        num_contacts=sum(len(runs(down[:, foot])[0]) for foot in range(2)),
        sliding_before=sliding[0],
        sliding_after=sliding[1],
        largest_level_shift=float(np.hypot(feet[..., 0], feet[..., 2]).max()),
        largest_height_shift=float(np.abs(feet[..., 1]).max()),
        has_fixed_bones=planting.bones is not None,
        largest_change=float(distance.max()),
        mean_change=float(distance.mean()),
    )
    return change, moved
