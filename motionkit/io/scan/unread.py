"""Files that are not motions: finding them in a source, and messages about them."""

import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from motionkit.core.errors import FormatError
from motionkit.io.arrays import npy, npz_archive
from motionkit.io.catalogue import readers
from motionkit.io.scan import annotations
from motionkit.io.scan.items import ReadOptions, ScanResult
from motionkit.io.source import source_file

# Limits of the message about a folder without motions.
SEEN_FILES, SHOWN_KINDS = 1_000, 3


def ignored(files: Iterable[Path], found: Sequence[tuple[Path, ScanResult]], read: Iterable[Path]) -> tuple[Path, ...]:
    """The files that are neither sequences nor problems and do not belong to a sequence.

    `found` are the folders of the source with the result for each, `read` other files that were read.
    """
    known = set(read)
    for folder, result in found:
        known.update(annotations.licence_files(folder))
        known.update(item.path for item in result.items)
        known.update(problem.path for problem in (*result.problems, *result.warnings))
        for name in {item.format for item in result.items}:
            known.update(readers()[name].beside(folder))
    return tuple(path for path in files if path not in known)


def kinds_of(paths: Iterable[Path]) -> dict[str, int]:
    """Number of files by suffix, or by name where there is none; the most frequent first."""
    return dict(Counter(path.suffix.lower() or path.name for path in paths).most_common())


def no_motion(source: Path, options: ReadOptions) -> FormatError:
    """The problem of a file or folder without motions."""
    expected = options.format if options.format != "auto" else ", ".join(readers())
    if source.is_file():
        if options.format == "auto" and source.suffix.lower() in PICKLES:
            return FormatError(_of_pickle(source), path=source, reason="pickle")
        arrays = describe_arrays(source) if options.format in ("auto", "npz", "joints-npy") else ""
        message = arrays or (_of_fbx(source) if source.suffix.lower() == FBX else "")
        message = message or f"of no known format, expected {expected}"
        return FormatError(message, path=source, reason="unknown-format")
    kinds = kinds_of(islice((path for path in source.rglob("*") if path.is_file()), SEEN_FILES))
    there = ", ".join(f"{count} {kind}" for kind, count in list(kinds.items())[:SHOWN_KINDS]) or "no files"
    message = f"no motions in this folder (it has {there}), expected {expected}"
    if kinds.keys() & {FBX, *PICKLES}:
        message += "; give one of its files to see how to convert it"
    return FormatError(message, path=source, reason="empty-folder")


FBX = ".fbx"
# The modules to import in Python to load it, and the call.
_TORCH = ("torch", "torch.load({!r}, map_location='cpu', weights_only=True)")
_PICKLE = ("pathlib, pickle", "pickle.loads(pathlib.Path({!r}).read_bytes())")
PICKLES = {".pt": _TORCH, ".pth": _TORCH, ".pkl": _PICKLE, ".pickle": _PICKLE}


def _of_pickle(path: Path) -> str:
    modules, load = PICKLES[path.suffix.lower()]
    target = str(path.with_suffix(".npz"))
    return (
        f"a pickle, which can run code when it is loaded, so it is not; one that you trust is written as arrays with "
        f"import numpy as np, {modules}; found = {load.format(str(path))}; np.savez({target!r}, fps=30, "
        "**{name: np.asarray(value) for name, value in found.items()}), if it is a dictionary and 30 its framerate "
        "(docs/formats.md, SMPL's parameters from other systems)"
    )


def _of_fbx(path: Path) -> str:
    # No FBX reader on PyPI is maintained well enough for untrusted files.
    script = (
        f"import bpy; bpy.ops.wm.read_factory_settings(use_empty=True); bpy.ops.import_scene.fbx(filepath={str(path)!r}"
        "); rig = next(each for each in bpy.data.objects if each.type == 'ARMATURE'); "
        "bpy.context.view_layer.objects.active = rig; first, last = map(int, rig.animation_data.action.frame_range); "
        f"bpy.ops.export_anim.bvh(filepath={str(path.with_suffix('.bvh'))!r}, frame_start=first, frame_end=last, "
        "root_transform_only=True)"
    )
    quoted = shlex.quote(script) if set(str(path)) & set('"$`\\!') else f'"{script}"'
    return f"FBX is not read; Blender makes a BVH file of it: blender --background --python-expr {quoted}"


SHOWN_ARRAYS = 8
POSE_VECTOR_WIDTHS = {263: "HumanML3D", 251: "KIT-ML", 262: "InterHuman", 272: "MotionStreamer"}


@dataclass(frozen=True)
class _Array:
    shape: tuple[int, ...]
    code: str

    def __str__(self) -> str:
        return f"{self.shape} {self._kind()}"

    @property
    def is_joints(self) -> bool:
        """Whether it could be frames × joints × 3."""
        return len(self.shape) == 3 and self.shape[2] == 3 and npy.NUMBERS.fullmatch(self.code) is not None

    @property
    def of_pose_vectors(self) -> str:
        """The data set whose pose vectors have this width, if any."""
        return POSE_VECTOR_WIDTHS.get(self.shape[1], "") if len(self.shape) == 2 else ""

    def _kind(self) -> str:
        if "O" in self.code:
            return "Python objects"
        if npy.STRINGS.fullmatch(self.code):
            return "text"
        try:
            return np.dtype(self.code).name
        except (TypeError, ValueError):
            return self.code[:40]


def describe_arrays(path: Path) -> str:
    """A description of a file's arrays, and how to make the file readable; empty for a file of another kind."""
    arrays = _arrays(path)
    if arrays is None:
        return ""
    listed = [f"{name} {array}".strip() for name, array in list(arrays.items())[:SHOWN_ARRAYS]]
    if len(arrays) > SHOWN_ARRAYS:
        listed.append(f"{len(arrays) - SHOWN_ARRAYS} more")
    return f"no motion as it is: it holds {', '.join(listed) or 'nothing'}; {_mend(path, arrays)}"


def _arrays(path: Path) -> dict[str, _Array] | None:
    match path.suffix.lower():
        case ".npy":
            header = npy.peek_header(path)
            return None if header is None else {"": _Array(header[0], header[2])}
        case ".npz":
            try:
                archive = npz_archive.open_archive(path, source_file.read_bytes(path))
                headers = {name: npz_archive.read_header(archive, name) for name in sorted(archive.members)}
            except FormatError:
                return None
            return {name: _Array(shape, code) for name, (shape, _, code) in headers.items()}
    return None


def _mend(path: Path, arrays: Mapping[str, _Array]) -> str:
    joints = next((name for name, array in arrays.items() if array.is_joints), None)
    vectors = next((name for name, array in arrays.items() if array.of_pose_vectors), None)
    if joints is None and vectors is not None:
        target = str(path.with_name(f"{path.stem}-motion.npy"))
        return (
            f"write one that can be read with np.save({target!r}, {_loaded(path, vectors)}), if these are pose vectors "
            f"as those of {arrays[vectors].of_pose_vectors}"
        )
    target = str(path.with_name(f"{path.stem}-motion.npz"))
    if joints is None:
        source, what = "joints", "joints being frames × joints × 3, in metres, y up, and 30 their framerate"
    else:
        source, what = _loaded(path, joints), "if these are metres, y up, and 30 is their framerate"
    return f"write one that can be read with np.savez({target!r}, joint_positions={source}, fps=30), {what}"


def _loaded(path: Path, name: str) -> str:
    loaded = f"np.load({str(path)!r})"
    return f"{loaded}[{name!r}]" if name else loaded
