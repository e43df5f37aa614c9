"""Resolves names (files, folders, ids of a store) to motions, and reads them."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from os import PathLike
from pathlib import Path
from typing import Generic, Literal, NamedTuple, TypeVar

from motionkit.core.errors import FormatError, StoreError, UsageError
from motionkit.core.files import is_store
from motionkit.core.framerate import Framerate, parse_fps
from motionkit.core.motion import Motion
from motionkit.core.progress import warn
from motionkit.core.skeletons.families import read_skeleton_map
from motionkit.io import joints_npy, npy
from motionkit.io import reading as one_sequence
from motionkit.io.humanml3d import JOINTS_FOLDER, LAYOUTS, VECTORS_FOLDER
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.io.scan import scan
from motionkit.io.source.source_file import dangling
from motionkit.io.up import GIVEN_AXES
from motionkit.store import Store

ReadT = TypeVar("ReadT")
SHOWN_IDS = 3


@dataclass(frozen=True)
class FoundMotion(Generic[ReadT]):
    """A motion to read lazily: `name` for messages, `short` without its folder, `read` loads it.

    Outputs are written next to `beside`: its path without suffix, with the key for a file of several motions.
    """

    name: str
    short: str
    beside: Path
    read: Callable[[], ReadT]


@dataclass(frozen=True)
class Readers(Generic[ReadT]):
    """Constructors: from files, and from a store."""

    item: Callable[[SourceItem], ReadT]
    stored: Callable[[Motion], ReadT]


def find_motions(
    names: Sequence[str], options: ReadOptions, store: Path, readers: Readers[ReadT]
) -> tuple[list[FoundMotion[ReadT]], list[FormatError]]:
    """The motions of files, folders and stores, or those of `store` with these ids; and problems of others.

    Raises `UsageError` for a name that is neither.
    """
    found: list[FoundMotion[ReadT]] = []
    problems: list[FormatError] = []
    opened = cache(lambda: Store.open(store))
    for name in (file for given in names for file in _pose_files(given)):
        path = Path(name)
        if not path.exists():
            found.append(_stored_named(name, store, opened, readers.stored))
        elif is_store(path):
            found += find_stored(path, None, readers.stored)
        elif (published := _of_pose_folder(path)) is not None:
            found.append(_of_item(published, path, readers.item))
        else:
            scanned = scan([path], options)
            # Of a file beside a data set's folders the data set is not meant.
            items = [item for item in scanned.items if path.is_dir() or item.path.resolve() == path.resolve()]
            if path.is_file() and not items and not scanned.problems:
                problems.append(FormatError("it is no motion, but a part of a folder", path=path, reason="part"))
            problems += scanned.problems
            found += [_of_item(item, path, readers.item) for item in items]
    return found, problems


def _pose_files(name: str) -> list[str]:
    """The files of `new_joints` or `new_joint_vecs` alone, where their folder is of HumanML3D's form; else the name."""
    files = sorted(Path(name).glob("*.npy")) if Path(name).name in (JOINTS_FOLDER, VECTORS_FOLDER) else []
    return [str(file) for file in files] if any(_of_pose_folder(file) for file in files) else [name]


def _of_pose_folder(path: Path) -> SourceItem | None:
    """A file in a folder of HumanML3D's form: what its place says, the framerate and the captions, belongs to it."""
    in_place = path.suffix.lower() == ".npy" and path.parent.name in (JOINTS_FOLDER, VECTORS_FOLDER)
    if not in_place or (path.parent / joints_npy.MANIFEST).is_file():
        return None
    shape = npy.peek_shape(path)
    for layout in LAYOUTS.values():
        if shape is not None and shape[1:] in ((layout.skeleton.num_joints, 3), (layout.num_values,)):
            path = path.resolve()
            return SourceItem(layout.name, path, path.parents[1], sequence_id=path.stem, key=path.stem)
    return None


def _of_item(item: SourceItem, named: Path, read: Callable[[SourceItem], ReadT]) -> FoundMotion[ReadT]:
    path = named if named.is_file() else named / item.path.relative_to(item.root)
    is_alone = item.key in ("", path.stem)
    key, stem = ("", path.stem) if is_alone else (f" ({item.key})", f"{path.stem}-{item.key}")
    return FoundMotion(f"{path}{key}", f"{path.name}{key}", path.with_name(stem), partial(read, item))


def find_stored(store: Path, where: str | None, stored: Callable[[Motion], ReadT]) -> list[FoundMotion[ReadT]]:
    """The sequences of a store, for which a condition holds if there is one; raises `StoreError` or `UsageError`."""
    opened = Store.open(store)
    rows = opened.rows_of(opened.select_some(where))
    ids: list[str] = opened.sequences_table["sequence_id"].take(rows).to_pylist()
    return [_stored(sequence_id, opened, stored) for sequence_id in ids]


def _stored_named(
    sequence_id: str, store: Path, opened: Callable[[], Store], made_of: Callable[[Motion], ReadT]
) -> FoundMotion[ReadT]:
    nowhere = f"there is no file or folder {sequence_id}"
    if not store.exists():
        raise UsageError(f"{nowhere}, and no store at {store} that could hold a sequence of that id")
    try:
        opened().index_of(sequence_id)
    except StoreError as error:
        raise UsageError(f"{nowhere}, and {error}") from None
    return _stored(sequence_id, opened(), made_of)


def _stored(sequence_id: str, store: Store, made_of: Callable[[Motion], ReadT]) -> FoundMotion[ReadT]:
    beside = Path(sequence_id.replace("/", "_").lstrip(".") or "clip")
    return FoundMotion(sequence_id, sequence_id, beside, lambda: made_of(store.read(sequence_id)))


class _Sequence(NamedTuple):
    id: str
    read: Callable[[], Motion]


def read(
    path: str | Path,
    *,
    sequence: str | None = None,
    format: str = "auto",
    fps: Framerate | None = None,
    unit_metres: int | float | None = None,
    up: str | None = None,
    skeleton_map: str | Path | None = None,
) -> Motion:
    """Read one motion from a file, or from a folder that holds one, at its native framerate.

    The format is found by name and content, or given by its name (docs/formats.md). `fps`, `unit_metres` (length of one
    file unit) and `up` (the axis "x", "y" or "z") replace what the file says or the motion shows; `skeleton_map` is a
    TOML table of how its rig becomes the 22 joints. Captions, action and licence come from an annotation table beside
    the file. Of a folder, `sequence` chooses one by its id or the end of it.

    Raises `FormatError` for a file that cannot be read, `UsageError` for a path that does not exist, and for a folder
    of several motions of which none is chosen.

    >>> mk.read("walk.bvh")
    Motion('captures/walk', 240 frames at 60 fps = 4.00 s, walk (22 joints), rotations, 1 captions)
    >>> mk.read("takes", sequence="jump").fps
    Fraction(30, 1)
    """
    path = existing_path(path)
    found, problems = _find(path, read_options(format, fps, unit_metres, up, skeleton_map))
    if sequence is not None:
        chosen = [each for each in found if each.id == sequence or each.id.endswith(f"/{sequence}")]
        if not chosen:
            raise problems[0] if not found else UsageError(f"{path} holds no motion {sequence!r}: {_named(found)}")
        found = chosen
    elif not found:
        raise problems[0]
    if len(found) > 1:
        raise UsageError(
            f"{path} holds {len(found):,} motions, {_named(found)}: read one of them with sequence={found[0].id!r}, or "
            "all of them with read_all"
        )
    if path.is_file():
        for problem in problems:
            warn(str(problem))
    return found[0].read()


def read_all(
    path: str | Path,
    *,
    format: str = "auto",
    fps: Framerate | None = None,
    unit_metres: int | float | None = None,
    up: str | None = None,
    skeleton_map: str | Path | None = None,
    on_error: Literal["stop", "skip"] = "stop",
) -> Iterator[Motion]:
    """Read all motions of a file or folder, one at a time as they are asked for; options are those of `read`.

    What cannot be read raises `FormatError`, or is left out with a warning where `on_error` is "skip". Raises
    `UsageError` for a path that does not exist.

    >>> [motion.sequence_id for motion in mk.read_all("takes")]
    ['takes/jump', 'takes/walk']
    """
    found, problems = _find(existing_path(path), read_options(format, fps, unit_metres, up, skeleton_map))
    return _each(found, problems, on_error)


def _each(found: list[_Sequence], problems: list[FormatError], on_error: Literal["stop", "skip"]) -> Iterator[Motion]:
    for problem in problems:
        if on_error == "stop":
            raise problem
        warn(str(problem))
    for each in found:
        try:
            yield each.read()
        except FormatError as error:
            if on_error == "stop":
                raise
            warn(str(error))


def read_options(
    format: str = "auto",
    fps: Framerate | None = None,
    unit_metres: int | float | None = None,
    up: str | None = None,
    skeleton_map: str | Path | None = None,
) -> ReadOptions:
    """Options of readers as people give them in Python; raises `ValueError` for a wrong rate, unit or axis."""
    if unit_metres is not None and not 0 < unit_metres < float("inf"):
        raise ValueError(f"unit_metres is a positive length, not {unit_metres}")
    if up is not None and up not in GIVEN_AXES:
        raise ValueError(f"up is {up!r}, expected the file's axis x, y or z that points up")
    return ReadOptions(
        format=format,
        fps=None if fps is None else parse_fps(fps),
        unit_metres=None if unit_metres is None else float(unit_metres),
        up=up or "",
        skeleton_maps=() if skeleton_map is None else (read_skeleton_map(Path(skeleton_map)),),
    )


def existing_path(path: object) -> Path:
    """The path of a file or folder that exists; raises `UsageError` for one that does not, and for another type."""
    if not isinstance(path, str | PathLike):
        raise UsageError(
            f"expected a motion, or the path of its file, not {type(path).__name__}: Motion.from_joints makes a motion "
            "of an array"
        )
    found = Path(path)
    if not found.exists():
        raise UsageError(str(dangling(found) or f"{found} does not exist"))
    return found


def _find(path: Path, options: ReadOptions) -> tuple[list[_Sequence], list[FormatError]]:
    if is_store(path):
        raise UsageError(f"{path} is a store: Store.open({str(path)!r}) reads it")

    def of_item(item: SourceItem) -> _Sequence:
        return _Sequence(item.sequence_id, partial(_read_item, item, options))

    readers = Readers(of_item, lambda motion: _Sequence(motion.sequence_id, lambda: motion))
    found, problems = find_motions([str(path)], options, path, readers)
    return [each.read() for each in found], list(map(_of_python, problems))


def _read_item(item: SourceItem, options: ReadOptions) -> Motion:
    try:
        return one_sequence.read(item, options)
    except FormatError as error:
        raise _of_python(error).with_traceback(error.__traceback__) from None


def _of_python(error: FormatError) -> FormatError:
    """The error with arguments of `read` for remedies (`fps=`), where readers name the command line's (`--fps`)."""
    message = re.sub(
        r"--(fps|unit-metres|skeleton-map)(?![\w-])", lambda said: said[1].replace("-", "_") + "=", error.message
    )
    return FormatError(message, path=error.path, reason=error.reason, line=error.line, frame=error.frame)


def _named(found: list[_Sequence]) -> str:
    more = " …" if len(found) > SHOWN_IDS else ""
    return ", ".join(each.id for each in found[:SHOWN_IDS]) + more
