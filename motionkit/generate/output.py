"""Generated motions as files: poses sampled from their fields, in every writable format or as HumanML3D's arrays."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.files import whole_file, write_whole
from motionkit.core.motion import Caption, Motion
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32, Float64
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError
from motionkit.core.timegrid import TimeGrid
from motionkit.edit.export.files import Outcome
from motionkit.edit.export.pose_folder import HUMANML3D_KIND, pose_entry, write_folder_manifest
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import MotionField, at_fps
from motionkit.generate.constraints import Followed, followed
from motionkit.generate.long_motions import Script, captions_of, constraints_of
from motionkit.io import joints_npy, npz
from motionkit.io.humanml3d import JOINTS_FOLDER, TEXTS_FOLDER, VECTORS_FOLDER
from motionkit.io.registry import Format, writers
from motionkit.io.texts import format_texts

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
        return Motion(
            self.joint_positions,
            self.skeleton,
            TimeGrid(self.fps, len(self.seconds), float(self.seconds[0])),
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
        action=action_of(script),
        followed=tuple(followed(field, each) for each in constraints_of(script)),
    )


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
    write: Callable[[Path, GeneratedSample], None]
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
    of_files = {name: _one_file(format) for name, format in writers().items()}
    npz_format = OutputFormat("npz", ("{}.npz",), _write_npz)
    return {**of_files, npz_format.name: npz_format, humanml3d.name: humanml3d}


def output_format(name: str, times: tuple[float, ...] = ()) -> OutputFormat:
    """The output format of a name; raises `UsageError` for an unknown one, or one that does not support `times`."""
    output = output_formats().get(name)
    if output is None:
        raise UsageError(f"--format is one of {', '.join(output_formats())}, not {name!r}")
    if times and name != "npz":
        raise UsageError(f"a {name} file has one framerate: --times goes with --format npz")
    return output


def _one_file(format: Format) -> OutputFormat:
    def write(path: Path, sample: GeneratedSample) -> None:
        assert format.write is not None
        with whole_file(path) as temporary:
            format.write(sample.motion(), temporary)

    shared = (format.shared_file,) if format.shared_file else ()
    return OutputFormat(format.name, (f"{{}}{format.suffixes[0]}",), write, shared=shared)


def _write_npz(path: Path, sample: GeneratedSample) -> None:
    """Write the arrays of `motionkit.io.npz`, and the requested `duration_seconds`.

    Poses at arbitrary instants have `time_seconds` and no `fps`.
    """
    if sample.fps is None:
        arrays = {
            "joint_positions": sample.joint_positions,
            "time_seconds": sample.seconds,
            **npz.skeleton_arrays(sample.skeleton),
            **npz.caption_arrays(sample.captions),
            "action": np.array(sample.action),
        }
    else:
        arrays = npz.motion_arrays(sample.motion())
    with whole_file(path) as temporary:
        npz.write_arrays(temporary, {**arrays, "duration_seconds": np.float64(sample.duration_seconds)})


def _write_humanml3d(path: Path, sample: GeneratedSample) -> None:
    """Write motions.json, texts/NAME.txt, new_joints/NAME.npy and new_joint_vecs/NAME.npy [T − 1, 263] (`path`).

    The vectors are at the sample's framerate; the published steps run on the motion (one skeleton, floor, origin,
    facing Z+). Raises `UsageError` for fewer than two poses.
    """
    motion, folder = sample.motion(), path.parents[1]
    kind = HUMANML3D_KIND.at(motion.fps)
    entry = pose_entry(motion, sample.name, kind)
    if isinstance(entry, Outcome):
        raise UsageError(f"{sample.name}: {entry.message}")
    if not (folder / joints_npy.MANIFEST).is_file():
        write_folder_manifest(folder, kind.layout)
    if entry.captions:
        text = format_texts(entry.captions, len(entry.joint_positions) / float(motion.fps))
        write_whole(folder / TEXTS_FOLDER / f"{sample.name}.txt", text)
    # The main file last: a motion that has it is complete.
    for place, array in ((folder / JOINTS_FOLDER / path.name, entry.joint_positions), (path, entry.vectors)):
        with whole_file(place) as temporary:
            np.save(temporary, np.asarray(array), allow_pickle=False)
