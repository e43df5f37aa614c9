"""Generated motions as files: sampled from their fields, written in any format or as HumanML3D's arrays."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from pathlib import Path, PurePosixPath

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.files import whole_file
from motionkit.edit.export.pose_folder import HUMANML3D_KIND, pose_entry, write_folder_manifest
from motionkit.edit.export.selection import Outcome
from motionkit.generate.samples import GeneratedSample
from motionkit.io import joints_npy, npz
from motionkit.io.catalogue import writers
from motionkit.io.format import Format
from motionkit.io.humanml3d import JOINTS_FOLDER, TEXTS_FOLDER, VECTORS_FOLDER, FolderWriter


def write_npz_file(path: Path, sample: GeneratedSample) -> None:
    """Write a .npz of `motionkit.io.npz`'s schema, atomically.

    Poses at arbitrary instants have `time_seconds` and no `fps`. In addition to the schema: `duration_seconds`, the
    requested duration.
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


def _write_file(path: Path, sample: GeneratedSample, format: Format) -> None:
    assert format.write is not None
    motion = sample.motion()
    with whole_file(path) as temporary:
        format.write(motion, temporary)


def write_humanml3d_files(path: Path, sample: GeneratedSample) -> None:
    """Write new_joint_vecs/NAME.npy [T − 1, 263] (`path`), new_joints/NAME.npy and texts/NAME.txt.

    The vectors are at the sample's framerate; the published steps run on the motion (one skeleton, floor, origin,
    facing Z+). Raises `UsageError` for fewer than two poses.
    """
    motion = sample.motion()
    kind = HUMANML3D_KIND.at(motion.fps)
    entry = pose_entry(motion, sample.name, kind)
    if isinstance(entry, Outcome):
        raise UsageError(f"{sample.name}: {entry.message}")
    for place in _HUMANML3D.files(sample.name):
        (path.parents[1] / place).unlink(missing_ok=True)  # do not write through a link
    FolderWriter(path.parents[1], kind.layout).add(entry)


def _begin_humanml3d(folder: Path, fps: Fraction) -> None:
    write_folder_manifest(folder, HUMANML3D_KIND.at(fps).layout)


def _begin_nothing(folder: Path, fps: Fraction) -> None:
    pass


@dataclass(frozen=True)
class OutputFormat:
    """An output format: `begin` writes shared files, `write` one motion to its first file.

    `patterns` are a motion's files below the folder, `shared` those of all. `fps` is the default framerate (None: the
    highest of the training data); `any_instants`: whether it supports poses at arbitrary instants.
    """

    name: str
    patterns: tuple[str, ...]
    write: Callable[[Path, GeneratedSample], None]
    fps: Fraction | None = None
    any_instants: bool = False
    begin: Callable[[Path, Fraction], None] = _begin_nothing
    shared: tuple[str, ...] = ()

    def files(self, motion: str) -> tuple[PurePosixPath, ...]:
        """The files of a motion of this name, the main one first."""
        return tuple(PurePosixPath(pattern.format(motion)) for pattern in self.patterns)


_NPZ = OutputFormat("npz", ("{}.npz",), write_npz_file, any_instants=True)
_HUMANML3D = OutputFormat(
    "humanml3d",
    (f"{VECTORS_FOLDER}/{{}}.npy", f"{JOINTS_FOLDER}/{{}}.npy", f"{TEXTS_FOLDER}/{{}}.txt"),
    write_humanml3d_files,
    fps=HUMANML3D_KIND.layout.fps,
    begin=_begin_humanml3d,
    shared=(joints_npy.MANIFEST,),
)


@cache
def output_formats() -> Mapping[str, OutputFormat]:
    """All output formats by name: a file per motion in every writable format, and HumanML3D's folder."""
    files = {name: _one_file(each) for name, each in writers().items()}
    return {**files, _NPZ.name: _NPZ, _HUMANML3D.name: _HUMANML3D}


def _one_file(format: Format) -> OutputFormat:
    shared = (format.shared_file,) if format.shared_file else ()
    return OutputFormat(format.name, (f"{{}}{format.suffixes[0]}",), partial(_write_file, format=format), shared=shared)


def output_format(name: str, times: tuple[float, ...] = ()) -> OutputFormat:
    """The output format of a name; raises `UsageError` for an unknown one, or one that does not support `times`."""
    output = output_formats().get(name)
    if output is None:
        raise UsageError(f"--format is one of {', '.join(output_formats())}, not {name!r}")
    if times and not output.any_instants:
        raise UsageError(f"a {name} file has one framerate: --times goes with --format npz")
    return output
