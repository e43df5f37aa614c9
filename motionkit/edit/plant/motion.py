"""`motionkit.edit.plant`: as the command, for a motion in memory."""

from pathlib import Path

from motionkit.core.motion import Motion
from motionkit.edit.complete.motion import clip_of
from motionkit.edit.plant.job import plant_clip
from motionkit.fields.contact.correction import Path as BodyPath


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
    clip = clip_of(motion)
    made, _, _ = plant_clip(clip, path)
    return clip.label(made.motion(0, made.grid.num_frames)).logged(made.line)
