"""Motions to look at: found in files, folders and stores by the names that people give, read whole with their holes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from motionkit.completing import vectors_npy
from motionkit.completing.holes import NAN, ReadClip, read_with_holes
from motionkit.errors import FormatError, StoreError, UsageError
from motionkit.formats.arrays import npy
from motionkit.formats.bvh.document import read_document
from motionkit.formats.items import ReadOptions, SourceItem
from motionkit.formats.pose_folders.humanml3d import HUMANML3D, JOINTS_FOLDER, VECTORS_FOLDER
from motionkit.formats.pose_folders.kit import KIT
from motionkit.formats.registry import scan, with_tables_above
from motionkit.store import Store

# Of .bvh files: frames that a tracker lost, and a skeleton that is no human body.
READABLE_ALL_THE_SAME = frozenset({NAN, "unit"})


@dataclass(frozen=True)
class ViewSource:
    """A motion to look at: `name` for people, `short` in the page, `stem` for its file, `read` when its turn comes."""

    name: str
    short: str
    stem: str
    read: Callable[[], ReadClip]


def find_sources(names: Sequence[str], options: ReadOptions, store: Path) -> tuple[list[ViewSource], list[FormatError]]:
    """The motions of files and folders, and of a store where no file has that name; and what is wrong with some.

    Raises `UsageError` for a name that is neither.
    """
    found: list[ViewSource] = []
    problems: list[FormatError] = []
    for name in names:
        path = Path(name)
        if not path.exists():
            found.append(_stored(name, store))
        elif (published := _of_pose_folder(path)) is not None:
            found.append(ViewSource(name, path.name, path.stem, partial(_read, published, options)))
        elif path.is_file() and vectors_npy.accepts(path):
            found.append(ViewSource(name, path.name, path.stem, partial(_vectors, path, options)))
        else:
            scanned = scan([path], options)
            items = [item for item in scanned.items if path.is_dir() or item.path.resolve() == path.resolve()]
            if path.is_file() and not items and not scanned.problems:
                problems.append(FormatError("it is no motion, but a part of a folder", path=path, reason="part"))
            problems += scanned.problems
            found += [_of_item(item, path, options) for item in items]
    return found, problems


def stored_where(store: Path, where: str) -> list[str]:
    """Ids of the stored sequences for which a condition holds, in the store's order; raises `StoreError`."""
    opened = Store.open(store)
    rows = opened.rows_of(opened.select(where))
    ids: list[str] = opened.sequences_table["sequence_id"].take(rows).to_pylist()
    return ids


def _of_pose_folder(path: Path) -> SourceItem | None:
    """A file in a folder of HumanML3D's form: what its place says, the framerate and the captions, belongs to it."""
    if path.suffix.lower() != ".npy" or path.parent.name not in (JOINTS_FOLDER, VECTORS_FOLDER):
        return None
    shape = npy.peek_shape(path)
    for layout in (HUMANML3D, KIT):
        if shape is not None and shape[1:] in ((layout.skeleton.num_joints, 3), (layout.num_values,)):
            path = path.resolve()
            return SourceItem(layout.name, path, path.parents[1], sequence_id=path.stem, key=path.stem)
    return None


def _of_item(item: SourceItem, path: Path, options: ReadOptions) -> ViewSource:
    name = str(path) if path.is_file() else str(path / item.path.relative_to(item.root))
    stem = item.key or item.path.stem
    key = f" ({item.key})" if item.key else ""
    item = with_tables_above(item) if path.is_file() else item
    return ViewSource(name + key, item.path.name + key, stem, partial(_read, item, options))


def _read(item: SourceItem, options: ReadOptions) -> ReadClip:
    try:
        return read_with_holes(item, options)
    except FormatError as error:
        if error.reason not in READABLE_ALL_THE_SAME or item.path.suffix.lower() != ".bvh":
            raise
    document = read_document(item.path, options)
    return ReadClip(replace(document.motion(), captions=item.captions), document.seen)


def _vectors(path: Path, options: ReadOptions) -> ReadClip:
    return ReadClip(*vectors_npy.read_vectors(path, options))


def _stored(sequence_id: str, store: Path) -> ViewSource:
    try:
        opened = Store.open(store)
        opened.index_of(sequence_id)
    except StoreError as error:
        raise UsageError(f"{sequence_id} is no file, and as the id of a stored sequence: {error}") from None

    def read() -> ReadClip:
        motion = opened.read(sequence_id)
        return ReadClip(motion, np.ones(motion.num_frames, bool))

    return ViewSource(sequence_id, sequence_id, sequence_id.replace("/", "_").lstrip("."), read)
