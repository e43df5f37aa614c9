"""Motions of files, folders, ids and stores, to be edited or looked at; and edited motions written to files."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import FormatError, MotionkitError, StoreError, UsageError
from motionkit.core.files import is_store, require_new, whole_file, write_json
from motionkit.core.motion import Motion
from motionkit.core.shapes import Bool, Float64
from motionkit.core.skeleton import STANDARD_SKELETONS
from motionkit.features import humanml3d
from motionkit.features.humanml3d import at_origin, facing_forward
from motionkit.fields.motion_field import Observation, Poses
from motionkit.io import joints_npy, pose_vectors
from motionkit.io.bvh import BvhDocument, KnownFrames, rewrite_bvh
from motionkit.io.files import existing_path, read_with_missing, sequences_at
from motionkit.io.humanml3d import LAYOUTS
from motionkit.io.registry import FileHead, ReadOptions, SourceItem, writer_of
from motionkit.io.scan import derived_folder, read_document
from motionkit.store import Store
from motionkit.viz.player import Panel, panel_of


@dataclass(frozen=True, eq=False)
class LoadedMotion:
    """A motion as it was read: a mask of its valid frames, and their times where these are not on its grid.

    Invalid frames repeat a valid one. A BVH file has its `document`, to be written with its own lines and channels.
    `suffix` is that of results that are written as the motion was; `note` says why that is another format. An array of
    pose vectors is written as one again (`is_pose_vectors`).
    """

    motion: Motion
    valid: Bool[np.ndarray, "frames"]
    uneven_seconds: Float64[np.ndarray, "frames"] | None = None
    document: BvhDocument | None = None
    suffix: str = ".npz"
    note: str = ""
    is_pose_vectors: bool = False

    @staticmethod
    def of(motion: Motion) -> "LoadedMotion":
        """A motion in memory, all of whose frames are valid."""
        return LoadedMotion(motion, np.ones(motion.num_frames, bool))

    def check_complete(self) -> None:
        """Raise `MotionkitError` for frames that hold nan or are uneven in time."""
        if not self.valid.all():
            lost = int((~self.valid).sum())
            raise MotionkitError(f"{lost:,} of its {len(self.valid):,} frames hold nan: complete it first")
        if self.uneven_seconds is not None:
            raise MotionkitError("its frames are uneven in time: complete it first, with --fps")

    @property
    def seconds(self) -> Float64[np.ndarray, "frames"]:
        """Times of the frames."""
        return self.motion.timegrid.seconds() if self.uneven_seconds is None else self.uneven_seconds

    @cached_property
    def poses(self) -> Poses:
        """All poses; those of a BVH file have rotations even if its bones move, which a `Motion` leaves out."""
        if self.document is not None and self.motion.local_rotations is None:
            return self.document.poses
        return Poses.of(self.motion)

    def panel(self, name: str) -> Panel:
        """The motion as it is drawn, its invalid frames marked."""
        return replace(
            panel_of(self.motion, name),
            uneven_seconds=self.uneven_seconds,
            start_seconds=float(self.seconds[0]),
            observed=None if self.valid.all() else self.valid,
        )

    def observation(self, observed: Bool[np.ndarray, "frames"]) -> Observation:
        """The poses of the `observed` frames at their times."""
        rows = slice(None) if observed.all() else np.flatnonzero(observed)
        return Observation(self.seconds[rows], self.poses.rows(rows), self.motion.skeleton)


@dataclass(frozen=True)
class MotionSource:
    """A motion that is read by `load`: its `name` for messages, and its `short_name` without the folder.

    Results are written next to `beside`: its path without suffix, with the key for a file of several motions. `kind` is
    framerate, source and action of a stored one.
    """

    name: str
    short_name: str
    beside: Path
    load: Callable[[], LoadedMotion]
    kind: tuple[str, ...] = ()

    @staticmethod
    def of(motion: Motion) -> "MotionSource":
        """A motion in memory, called by its id."""
        name = motion.sequence_id or "motion"
        return MotionSource(name, name, _file_name(name), lambda: LoadedMotion.of(motion))


def find_motions(
    names: Sequence[str], options: ReadOptions, store: Path, where: str | None = None
) -> tuple[list[MotionSource], list[FormatError]]:
    """The motions of files, folders, stores and ids of `store`, and of `store` those that satisfy the SQL `where`.

    The second list has the problems of files that cannot be read. Raises `UsageError` for a name that is none of these,
    for a condition that no sequence satisfies, and for options of files where none is named.
    """
    sources: list[MotionSource] = []
    problems: list[FormatError] = []
    opened = cache(lambda: Store.open(store))
    for name in names:
        path = Path(name)
        if is_store(path):
            sources += _stored(Store.open(path), None)
        elif path.exists():
            items, faults = sequences_at(path, options)
            sources += [_of_item(item, item_path, options) for item_path, item in items]
            problems += faults
        elif not store.exists():
            raise UsageError(
                f"there is no file or folder {name}, and no store at {store} that could hold a sequence of that id"
            )
        else:
            try:
                opened().index_of(name)
            except StoreError as error:
                raise UsageError(f"there is no file or folder {name}, and {error}") from None
            sources.append(_of_store(name, opened()))
    if where is not None:
        sources += _stored(opened(), where)
    has_files = any(Path(name).exists() and not is_store(Path(name)) for name in names)
    if not has_files and replace(options, skip_derived=False) != ReadOptions():
        raise UsageError("a framerate, unit, axis or skeleton map is for files: stored sequences have theirs")
    return sources, problems


def load_motion(motion: Motion | str | Path, options: ReadOptions | None = None) -> LoadedMotion:
    """A motion in memory or of a file; raises what reading it raises, and `UsageError` for a file of several."""
    if isinstance(motion, Motion):
        return LoadedMotion.of(motion)
    path = existing_path(motion)
    sources, problems = find_motions([str(path)], options or ReadOptions(), path)
    if not sources:
        raise problems[0]
    if len(sources) > 1:
        raise UsageError(f"{path} holds {len(sources):,} motions: read_all(path) reads them one by one")
    return sources[0].load()


def _of_item(item: SourceItem, path: Path, options: ReadOptions) -> MotionSource:
    is_alone = item.key in ("", path.stem)
    key, stem = ("", path.stem) if is_alone else (f" ({item.key})", f"{path.stem}-{item.key}")
    return MotionSource(f"{path}{key}", f"{path.name}{key}", path.with_name(stem), partial(_load_item, item, options))


def _load_item(item: SourceItem, options: ReadOptions) -> LoadedMotion:
    document = read_document(item, options)
    if document is not None:
        return replace(LoadedMotion.of(document.motion), document=document, suffix=".bvh")
    motion, valid, uneven_seconds = read_with_missing(item, options)
    suffix, note = item.path.suffix.lower(), ""
    if suffix == ".npy" and FileHead(item.path).row_width in pose_vectors.LAYOUT_BY_WIDTH:
        return LoadedMotion(motion, valid, uneven_seconds, suffix=suffix, is_pose_vectors=True)
    is_writable = item.format == "npz" or (suffix == ".npy" and motion.skeleton in STANDARD_SKELETONS.values())
    if not is_writable:
        suffix = ".npz" if motion.local_rotations is None else ".bvh"
        note = f"{item.format} cannot be written: its result is a {suffix[1:]} file"
    return LoadedMotion(motion, valid, uneven_seconds, suffix=suffix, note=note)


def _stored(store: Store, where: str | None) -> list[MotionSource]:
    rows = store.rows_of(store.select_some(where))
    columns = (
        store.sequences_table[name].take(rows).to_pylist() for name in ("sequence_id", "fps", "source", "action")
    )
    return [
        replace(_of_store(name, store), kind=(str(fps), *others)) for name, fps, *others in zip(*columns, strict=True)
    ]


def _of_store(sequence_id: str, store: Store) -> MotionSource:
    return MotionSource(
        sequence_id, sequence_id, _file_name(sequence_id), lambda: LoadedMotion.of(store.read(sequence_id))
    )


def _file_name(sequence_id: str) -> Path:
    return Path(sequence_id.replace("/", "_").lstrip(".") or "motion")


@dataclass(frozen=True, eq=False)
class EditedMotion:
    """A motion made of a loaded one, how it is written to a file, and what to tell.

    `details` are facts as JSON; `warnings` and the `remark` are lines.
    """

    motion: Motion
    write: Callable[[Path], None]
    details: Mapping[str, Any]
    warnings: Sequence[str] = ()
    remark: str = ""


def edit_file(
    source: MotionSource,
    edit: Callable[[LoadedMotion], EditedMotion],
    paths: "OutputPaths",
    fps: Fraction | None = None,
) -> tuple[Path, EditedMotion]:
    """Read, edit and write one motion, whose framerate will be `fps` (None: its own).

    Raises `MotionkitError` or `OSError` without leaving files behind.
    """
    loaded = source.load()
    path = paths.path(source, loaded, fps or loaded.motion.fps)
    edited = edit(loaded)
    with whole_file(path) as temporary:
        edited.write(temporary)
    note = [loaded.note] if loaded.note and paths.suffix is None else []
    return path, replace(edited, warnings=[*edited.warnings, *note])


def write_as_loaded(loaded: LoadedMotion, motion: Motion, known: KnownFrames, path: Path) -> None:
    """Write an edited motion in the format of the path's suffix; BVH files and pose vectors as they came.

    In a BVH file with a document, `known` frames keep their lines, and others have its channels. Raises what the writer
    raises.
    """
    suffix = path.suffix.lower()
    if loaded.document is not None and motion.local_rotations is not None and suffix == ".bvh":
        rewrite_bvh(loaded.document, path, motion, known)
    elif loaded.is_pose_vectors and suffix == ".npy":
        _write_pose_vectors(motion, path)
    else:
        writer_of(suffix)(motion, path)


def _write_pose_vectors(motion: Motion, path: Path) -> None:
    """Write T − 1 rows of 263 or 251 numbers for T poses, and the framerate to `motions.json` beside them.

    Rates in the vectors are per frame, so they are those of the motion's framerate. Positions are where the first frame
    is above the origin and faces Z+, as the convention has it; nothing is scaled. Raises `MotionkitError` for one pose,
    and for a folder whose `motions.json` says another framerate.
    """
    layout = next(each for each in LAYOUTS.values() if each.skeleton == motion.skeleton)
    if motion.num_frames < 2:
        raise MotionkitError("pose vectors need at least two poses")
    name = layout.skeleton.name
    positions = facing_forward(at_origin(motion.joint_positions / np.float32(layout.unit_metres)), name)
    manifest = path.parent / joints_npy.MANIFEST
    if joints_npy.read_manifest(manifest).fps not in (None, motion.fps):
        raise MotionkitError(f"{manifest} says another framerate than {motion.fps}: one folder holds one, use --out")
    np.save(path, humanml3d.vectors(positions, name), allow_pickle=False)
    write_json(manifest, {"fps": str(motion.fps), "layout": name, "vectors": humanml3d.CONVENTION})


class OutputPaths:
    """The files of results: `--out`, or in `--out`, or beside each source as `NAME.EDIT.EXT`; no two are the same.

    `edit` says what was done (`completed`), `names` are those that the user gave. Raises `UsageError` for a suffix that
    no format writes, for a format that is not that of the file, and for one file where several motions are written.
    `suffix` is None where results are written as their sources were.
    """

    def __init__(
        self,
        edit: str,
        names: Sequence[str],
        num_motions: int,
        *,
        out: Path | None = None,
        file_format: str | None = None,
        overwrite: bool = False,
        usual_suffix: str | None = None,
    ) -> None:
        self._edit, self._out, self._overwrite = edit, out, overwrite
        self._folders = [Path(name) for name in names if Path(name).is_dir()]
        self.suffix = usual_suffix if file_format is None else f".{file_format}"
        self._is_file = out is not None and bool(out.suffix) and not out.is_dir()
        self._source_of: dict[Path, str] = {}
        if out is not None and self._is_file:
            if num_motions > 1 or self._folders or not names:
                raise UsageError(f"{out} is one file: for several motions name a folder, without a suffix")
            if file_format is not None and self.suffix != out.suffix.lower():
                raise UsageError(f"--format {file_format} and --out {out} are two formats: give one of them")
            self.suffix = out.suffix.lower()
        if self.suffix is not None:
            writer_of(self.suffix)

    def path(self, source: MotionSource, loaded: LoadedMotion, fps: Fraction) -> Path:
        """The file of a result at a framerate.

        Raises `MotionkitError` for a file that exists, unless it may be overwritten, and for that of another source.
        """
        stem, suffix = source.beside.name, self.suffix or loaded.suffix
        if self._out is not None and self._is_file:
            path = self._out
        elif self._out is not None:
            folder = next((each for each in self._folders if source.beside.is_relative_to(each)), None)
            path = self._out / (source.beside.relative_to(folder).parent if folder else "") / f"{stem}{suffix}"
        elif suffix == ".npy":
            # A motions.json states the framerate of all arrays beside it, so new ones need their own folder.
            path = source.beside.with_name(derived_folder(str(fps), self._edit)) / f"{stem}.npy"
        else:
            path = source.beside.with_name(f"{stem}.{self._edit}{suffix}")
        other = self._source_of.setdefault(path.absolute(), source.name)
        if other != source.name:
            raise MotionkitError(f"its result would be {path}, as that of {other}: name them one by one with --out")
        require_new(path, overwrite=self._overwrite, instead="--out writes elsewhere")
        return path
