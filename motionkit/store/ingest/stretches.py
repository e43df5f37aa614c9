"""A stretch of the sources, some megabytes: whoever takes it reads it and writes it as one part of the store."""

import os
import socket
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from motionkit.core.errors import FormatError, StoreError
from motionkit.core.skeleton import Skeleton
from motionkit.formats.scan.items import ReadOptions, SourceItem
from motionkit.formats.scan.reading import read
from motionkit.store.codec import EncodedMotion, RefusedMotion, Row, encode
from motionkit.store.commit import unique_pending_part
from motionkit.store.parts import PartWriter, PendingPart
from motionkit.store.schema import SEGMENTS_FOLDER

# A second of reading, and a part of about 10 MB.
STRETCH_BYTES = 32 * 2**20
STRETCH_ITEMS = 1024


@dataclass(frozen=True)
class NumberedItem:
    """A sequence to be read and the index that it gets; None where the store has its id, so that it is read only."""

    item: SourceItem
    sequence_index: int | None

    def __str__(self) -> str:
        return str(self.item)


@dataclass(frozen=True, eq=False)
class ReadSequence:
    """A sequence that was read: its row of the table, but for the part, where it was written, and its skeleton."""

    row: Row
    skeleton: Skeleton


@dataclass(frozen=True, eq=False)
class ReadStretch:
    """What became of a stretch: the part, None where nothing was to be written, and an outcome for each item."""

    part: PendingPart | None
    outcomes: tuple[ReadSequence | FormatError, ...]


def cut(items: Iterable[SourceItem]) -> Iterator[list[SourceItem]]:
    """The items in order, in stretches of at most 32 MiB of files; a larger file is a stretch of its own.

    The cut depends on the items alone. Sequences of one file come into one stretch, so that it is read once, unless
    they are more than 1,024.
    """
    stretch: list[SourceItem] = []
    num_bytes = 0
    for path, of_file in groupby(items, key=lambda item: item.path):
        size = _size(path)
        if stretch and num_bytes + size > STRETCH_BYTES:
            yield stretch
            stretch, num_bytes = [], 0
        num_bytes += size
        for item in of_file:
            if len(stretch) == STRETCH_ITEMS:
                yield stretch
                stretch, num_bytes = [], size
            stretch.append(item)
    if stretch:
        yield stretch


def read_stretch(items: Sequence[NumberedItem], store: Path, options: ReadOptions) -> ReadStretch:
    """Read sequences and write those that have an index into one part of the store, under a pending name.

    A fault of a source is returned, so that it travels between processes like a result. Raises `OSError` where the part
    cannot be written, and `StoreError` where there is no such store.
    """
    if not (store / SEGMENTS_FOLDER).is_dir():
        raise StoreError(f"there is no store {store} on {socket.gethostname()}: it must be where all machines see it")
    part = PartWriter(unique_pending_part(store, items[0].sequence_index or 0))
    skeletons: dict[str, Skeleton] = {}
    outcomes: list[ReadSequence | FormatError] = []
    try:
        for each in items:
            motion = read_or_fault(each.item, options)
            if isinstance(motion, FormatError):
                outcomes.append(motion)
                continue
            row = motion.row
            if each.sequence_index is not None:
                first_row = part.add(each.sequence_index, motion.runs)
                row = {**row, "sequence_index": each.sequence_index, "first_row": first_row}
            skeleton = skeletons.setdefault(motion.skeleton.fingerprint, motion.skeleton)
            outcomes.append(ReadSequence(row, skeleton))
        return ReadStretch(part.finish(), tuple(outcomes))
    finally:
        part.abandon()


def read_or_fault(item: SourceItem, options: ReadOptions) -> EncodedMotion | FormatError:
    """Read and encode one sequence, or say what is wrong with it.

    An exception that no reader foresaw becomes a fault too (`unexpected`): one odd file must not end an ingest of a
    million.
    """
    try:
        return encode(read(item, options))
    except FormatError as problem:
        return problem if os.path.lexists(item.path) else _not_visible(item)
    except RefusedMotion as refused:
        return FormatError(str(refused), path=item.path, reason=refused.reason)
    except Exception as error:
        text = f"{type(error).__name__}: {error}".splitlines()[0]
        return FormatError(f"the {item.format} reader failed: {text}", path=item.path, reason="unexpected")


def _not_visible(item: SourceItem) -> FormatError:
    return FormatError(
        f"there is no such file on {socket.gethostname()}, where it was to be read, but there was when the source was "
        "scanned: removed since, or not in a folder that all machines share",
        path=item.path,
        reason="not-visible",
    )


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
