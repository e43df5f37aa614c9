"""Motions found by the names that people give: files, folders, ids of a store."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Generic, TypeVar

from motionkit.core.errors import FormatError, StoreError, UsageError
from motionkit.core.motion import Motion
from motionkit.formats.arrays import npy
from motionkit.formats.humanml3d import JOINTS_FOLDER, LAYOUTS, VECTORS_FOLDER
from motionkit.formats.scan.items import ReadOptions, SourceItem
from motionkit.formats.scan.scanner import scan, with_tables_above
from motionkit.store import Store
from motionkit.store.named_motions import vectors_npy

ReadT = TypeVar("ReadT")


@dataclass(frozen=True)
class Found(Generic[ReadT]):
    """A motion that was found: `name` for people, `short` without its folder, `read` for when its turn comes.

    What is made of it goes by `beside`: its path without a suffix, and with the key of a file that holds several.
    """

    name: str
    short: str
    beside: Path
    read: Callable[[], ReadT]


@dataclass(frozen=True)
class Readers(Generic[ReadT]):
    """How motions become what is asked for: those of files, of arrays of pose vectors alone, of a store."""

    item: Callable[[SourceItem], ReadT]
    vectors: Callable[[Path], ReadT]
    stored: Callable[[Motion], ReadT]


def find_motions(
    names: Sequence[str], options: ReadOptions, store: Path, readers: Readers[ReadT]
) -> tuple[list[Found[ReadT]], list[FormatError]]:
    """The motions of files and folders, and of a store where no file has that name; and what is wrong with some.

    Raises `UsageError` for a name that is neither.
    """
    found: list[Found[ReadT]] = []
    problems: list[FormatError] = []
    opened = cache(lambda: Store.open(store))
    for name in names:
        path = Path(name)
        if not path.exists():
            found.append(_named(name, opened, readers.stored))
        elif (published := _of_pose_folder(path)) is not None:
            found.append(_of_item(published, path, readers.item))
        elif path.is_file() and vectors_npy.accepts(path):
            found.append(Found(name, path.name, path.with_suffix(""), partial(readers.vectors, path)))
        else:
            scanned = scan([path], options)
            # Of a file beside a data set's folders the data set is not meant.
            items = [item for item in scanned.items if path.is_dir() or item.path.resolve() == path.resolve()]
            if path.is_file() and not items and not scanned.problems:
                problems.append(FormatError("it is no motion, but a part of a folder", path=path, reason="part"))
            problems += scanned.problems
            found += [_of_item(item, path, readers.item) for item in items]
    return found, problems


def _of_pose_folder(path: Path) -> SourceItem | None:
    """A file in a folder of HumanML3D's form: what its place says, the framerate and the captions, belongs to it."""
    if path.suffix.lower() != ".npy" or path.parent.name not in (JOINTS_FOLDER, VECTORS_FOLDER):
        return None
    shape = npy.peek_shape(path)
    for layout in LAYOUTS.values():
        if shape is not None and shape[1:] in ((layout.skeleton.num_joints, 3), (layout.num_values,)):
            path = path.resolve()
            return SourceItem(layout.name, path, path.parents[1], sequence_id=path.stem, key=path.stem)
    return None


def _of_item(item: SourceItem, named: Path, read: Callable[[SourceItem], ReadT]) -> Found[ReadT]:
    path = named if named.is_file() else named / item.path.relative_to(item.root)
    item = with_tables_above(item) if named.is_file() else item
    is_alone = item.key in ("", path.stem)
    key, stem = ("", path.stem) if is_alone else (f" ({item.key})", f"{path.stem}-{item.key}")
    return Found(f"{path}{key}", f"{path.name}{key}", path.with_name(stem), partial(read, item))


def find_stored(store: Path, where: str, stored: Callable[[Motion], ReadT]) -> list[Found[ReadT]]:
    """The sequences of a store for which a condition holds, in its order; raises `StoreError` or `UsageError`."""
    opened = Store.open(store)
    rows = opened.rows_of(opened.select(where))
    ids: list[str] = opened.sequences_table["sequence_id"].take(rows).to_pylist()
    return [_stored(sequence_id, opened, stored) for sequence_id in ids]


def _named(sequence_id: str, opened: Callable[[], Store], made_of: Callable[[Motion], ReadT]) -> Found[ReadT]:
    try:
        opened().index_of(sequence_id)
    except StoreError as error:
        raise UsageError(f"{sequence_id} is no file, and as the id of a stored sequence: {error}") from None
    return _stored(sequence_id, opened(), made_of)


def _stored(sequence_id: str, store: Store, made_of: Callable[[Motion], ReadT]) -> Found[ReadT]:
    beside = Path(sequence_id.replace("/", "_").lstrip(".") or "clip")
    return Found(sequence_id, sequence_id, beside, lambda: made_of(store.read(sequence_id)))
