"""Measures what planting changed: contacts, their sliding, displacements of joints."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from motionkit.core.shapes import Bool, Float64
from motionkit.fields.contact.correction import Correction
from motionkit.fields.contact.detection import runs
from motionkit.fields.contact.planted import PlantedField

FRAMES_AT_ONCE = 4096
MOVED_METRES = 2e-5


@dataclass(frozen=True)
class Change:
    """Changes of a motion in m, m/s and s; speeds are None for feet without contact.

    `sliding` is the mean horizontal speed of feet in contact, weighted towards the steadier of ankle and toe.
    `below_ground` is the maximum depth of a foot joint below its floor. `largest_level_shift` and
    `largest_height_shift` are how far the correction moves a foot along the ground, and up or down to it;
    `has_fixed_bones` is whether positions without rotations were projected onto bones of constant length.
    `largest_pose_change` is relative to the first joint, so that it ignores a displacement of the whole body.
    """

    num_contacts: int
    contact_seconds: float
    sliding_before: float | None
    sliding_after: float | None
    below_ground_before: float
    below_ground_after: float
    largest_level_shift: float
    largest_height_shift: float
    has_fixed_bones: bool
    largest_change: float
    largest_pose_change: float
    mean_change: float
    moved_share: float

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)


def measure_change(
    field: PlantedField, times: Float64[np.ndarray, "frames"], on_frames: Callable[[int], None] = lambda _: None
) -> tuple[Change, Bool[np.ndarray, "frames"]]:
    """Measure what planting changes at these ascending times, and which frames it moves.

    Frames are processed in blocks of some thousand; `on_frames` is called with the size of each.
    """
    moved = np.zeros(len(times), bool)
    largest, of_pose, total = 0.0, 0.0, 0.0
    ground = field.correction.ground
    below = np.zeros(2)
    for start in range(0, len(times), FRAMES_AT_ONCE):
        some = slice(start, min(start + FRAMES_AT_ONCE, len(times)))
        before, after = field.field.query(times[some]).joint_positions, field.query(times[some]).joint_positions
        step = after - before
        change = np.linalg.norm(step, axis=-1)
        of_pose = max(of_pose, float(np.linalg.norm(step - step[:, :1], axis=-1).max()))
        moved[some] = change.max(axis=1) > MOVED_METRES
        largest, total = max(largest, float(change.max())), total + float(change.mean(axis=1).sum())
        for place, positions in enumerate((before, after)):
            depth = ground.floor - field.legs.foot_paths(positions)[..., 1]
            below[place] = max(below[place], float(depth.max()))
        on_frames(len(change))
    contacts, seconds, speeds = _contacts(field.correction)
    level_shift, height_shift = _shifts(field.correction)
    return (
        Change(
            num_contacts=contacts,
            contact_seconds=seconds,
            sliding_before=speeds[0],
            sliding_after=speeds[1],
            below_ground_before=float(below[0]),
            below_ground_after=float(below[1]),
            largest_level_shift=level_shift,
            largest_height_shift=height_shift,
            has_fixed_bones=field.bones is not None,
            largest_change=largest,
            largest_pose_change=of_pose,
            mean_change=total / len(times),
            moved_share=float(moved.mean()),
        ),
        moved,
    )


def _contacts(correction: Correction) -> tuple[int, float, tuple[float | None, float | None]]:
    """Number and seconds of a foot's contacts, and its speed there without and with the correction."""
    if not correction.is_possible or not correction.contacts.down.any():
        return 0, 0.0, (None, None)
    down, velocity = np.asarray(correction.contacts.down.any(axis=-1)), correction.contacts.velocity
    moves = np.gradient(correction.offsets[:, :1] + correction.offsets[:, 1:], axis=0) * correction.fps
    before, after = (float(np.hypot(each[..., 0], each[..., 2])[down].mean()) for each in (velocity, velocity + moves))
    count = sum(len(runs(down[:, foot])[0]) for foot in range(2))
    return count, int(down.sum()) / correction.fps, (before, after)


def _shifts(correction: Correction) -> tuple[float, float]:
    """The largest offset of a foot along the ground, and up or down."""
    if not correction.is_possible:
        return 0.0, 0.0
    feet = correction.offsets[:, :1] + correction.offsets[:, 1:]
    return float(np.hypot(feet[..., 0], feet[..., 2]).max()), float(np.abs(feet[..., 1]).max())
