"""Generated motions as files: poses sampled from their fields, in every writable format or as HumanML3D's arrays."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path, PurePosixPath

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.files import whole_file, write_whole
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.core.shapes import Float64
from motionkit.core.skeletons.mapping import SkeletonMapError
from motionkit.core.timegrid import TimeGrid
from motionkit.edit.export import HUMANML3D_KIND, Outcome, pose_entry, write_folder_manifest
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import MotionField, at_fps
from motionkit.generate.long_motions import Script, captions_of
from motionkit.io import joints_npy, npz
from motionkit.io.humanml3d import JOINTS_FOLDER, TEXTS_FOLDER, VECTORS_FOLDER
from motionkit.io.registry import Format, writers
from motionkit.io.texts import format_texts

SLUG_LENGTH = 40


def sample_motion(field: MotionField, name: str, script: Script, fps: Fraction) -> Motion:
    """A generated field as a motion: frame k at k / fps, in the half-open interval that it lasts.

    Four seconds at 20 fps are 80 frames; `to_motion` would include the frame at the closed end too.
    """
    duration = field.end_seconds - field.start_seconds
    grid = TimeGrid(fps, max(1, int(np.ceil(duration * float(fps) - 1e-6))), field.start_seconds)
    return Motion(
        at_fps(field, fps).query(grid.seconds()).joint_positions,
        field.skeleton,
        grid,
        captions=captions_of(script),
        action=action_of(script),
        sequence_id=name,
    )


def write_instants(path: Path, field: MotionField, script: Script, seconds: Float64[np.ndarray, "times"]) -> None:
    """Write the poses of a field at arbitrary instants as a .npz: `time_seconds`, no framerate."""
    arrays = {
        "joint_positions": field.query(seconds).joint_positions,
        "time_seconds": seconds,
        **npz.skeleton_arrays(field.skeleton),
        **npz.caption_arrays(captions_of(script)),
        "action": np.array(action_of(script)),
        "duration_seconds": np.float64(field.end_seconds - field.start_seconds),
    }
    with whole_file(path) as temporary:
        npz.write_arrays(temporary, arrays)


def plant_generated(field: MotionField, script: Script) -> MotionField:
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


def action_of(script: Script) -> str:
    """The action of all requests of a script; empty if they differ."""
    return script[0].action if len({request.action for request in script}) == 1 else ""


def motion_name(index: int, script: Script) -> str:
    """A descriptive file name for the index-th motion: `0003-a-person-walks`."""
    conditions = " ".join(request.text or request.action for request in script).strip() or "unconditional"
    slug = re.sub(r"[^a-z0-9]+", "-", conditions.lower()).strip("-")
    return f"{index:04d}-{slug[:SLUG_LENGTH].strip('-') or 'motion'}"


@dataclass(frozen=True)
class OutputFormat:
    """An output format: `write` writes one motion, given the path of its main file.

    `patterns` are a motion's files below the folder, the main one first; `shared` are files of all motions. `fps` is
    the default framerate (None: the highest of the training data).
    """

    name: str
    patterns: tuple[str, ...]
    write: Callable[[Path, Motion], None]
    fps: Fraction | None = None
    shared: tuple[str, ...] = ()

    def files(self, motion: str) -> tuple[PurePosixPath, ...]:
        """The files of a motion of this name, the main one first."""
        return tuple(PurePosixPath(pattern.format(motion)) for pattern in self.patterns)


@cache
def output_formats() -> Mapping[str, OutputFormat]:
    """All output formats by name: a file per motion in every writable format, and HumanML3D's folder."""
    humanml3d = OutputFormat(
        "humanml3d",
        (f"{VECTORS_FOLDER}/{{}}.npy", f"{JOINTS_FOLDER}/{{}}.npy", f"{TEXTS_FOLDER}/{{}}.txt"),
        _write_humanml3d,
        fps=HUMANML3D_KIND.layout.fps,
        shared=(joints_npy.MANIFEST,),
    )
    return {**{name: _one_file(format) for name, format in writers().items()}, humanml3d.name: humanml3d}


def output_format(name: str, times: tuple[float, ...] = ()) -> OutputFormat:
    """The output format of a name; raises `UsageError` for an unknown one, or one that does not support `times`."""
    output = output_formats().get(name)
    if output is None:
        raise UsageError(f"--format is one of {', '.join(output_formats())}, not {name!r}")
    if times and name != "npz":
        raise UsageError(f"a {name} file has one framerate: --times goes with --format npz")
    return output


def _one_file(format: Format) -> OutputFormat:
    def write(path: Path, motion: Motion) -> None:
        assert format.write is not None
        with whole_file(path) as temporary:
            format.write(motion, temporary)

    shared = (format.shared_file,) if format.shared_file else ()
    return OutputFormat(format.name, (f"{{}}{format.suffixes[0]}",), write, shared=shared)


def _write_humanml3d(path: Path, motion: Motion) -> None:
    """Write motions.json, texts/NAME.txt, new_joints/NAME.npy and new_joint_vecs/NAME.npy [T − 1, 263] (`path`).

    The vectors are at the motion's framerate; the published steps run on the motion (one skeleton, floor, origin,
    facing Z+). Raises `UsageError` for fewer than two poses.
    """
    name, folder = motion.sequence_id, path.parents[1]
    kind = HUMANML3D_KIND.at(motion.fps)
    entry = pose_entry(motion, name, kind)
    if isinstance(entry, Outcome):
        raise UsageError(f"{name}: {entry.message}")
    if not (folder / joints_npy.MANIFEST).is_file():
        write_folder_manifest(folder, kind.layout)
    if entry.captions:
        text = format_texts(entry.captions, len(entry.joint_positions) / float(motion.fps))
        write_whole(folder / TEXTS_FOLDER / f"{name}.txt", text)
    # The main file last: a motion that has it is complete.
    for place, array in ((folder / JOINTS_FOLDER / path.name, entry.joint_positions), (path, entry.vectors)):
        with whole_file(place) as temporary:
            np.save(temporary, np.asarray(array), allow_pickle=False)
