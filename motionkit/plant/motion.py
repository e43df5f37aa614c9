"""One motion planted, in Python: what `motionkit plant` does with each clip, without files."""

from pathlib import Path

from motionkit.complete.clips import clip_of_motion
from motionkit.complete.motion import clip_of_file
from motionkit.core.motion import Motion
from motionkit.fields.contact.correction import Path as BodyPath
from motionkit.plant.job import plant_clip


def plant(motion: Motion | str | Path, *, path: BodyPath = "near") -> Motion:
    """A motion whose feet stand where they slid: the body is moved and the legs are bent, bones keep their length.

    - `motion`: a motion, or a file; a skeleton of its own is known by its joints' names (docs/formats.md)
    - `path`: "near" the path that the body had; or "free", where its feet carry it, for generated motion

    Real feet roll, pivot and creep: what is not faster than that stays as it is (docs/plant.md). Raises
    `MotionkitError` for frames that hold nan and for a skeleton whose legs aren't known.

    >>> motion = mk.read("walk.bvh")
    >>> mk.plant(motion).num_frames
    240
    """
    clip = clip_of_motion(motion) if isinstance(motion, Motion) else clip_of_file(Path(motion))
    made, _, _ = plant_clip(clip, path)
    return clip.label(made.motion(0, made.grid.num_frames)).logged(made.line)
