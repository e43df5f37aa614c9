"""Chunks of the sources, some megabytes each: a worker reads one and writes it as one part of the store."""

import os
import socket
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from motionkit.core.errors import FormatError, StoreError
from motionkit.core.skeleton import Skeleton
from motionkit.io.scan.items import ReadOptions, SourceItem
from motionkit.io.scan.reading import read
from motionkit.store.codec import EncodedMotion, RefusedMotion, Row, encode
from motionkit.store.commit import unique_pending_part
from motionkit.store.parts import PartWriter, PendingPart
from motionkit.store.schema import SEGMENTS_FOLDER

# A second of reading, and a part of about 10 MB: keeps all workers busy for small corpora.
STRETCH_BYTES = 32 * 2**20
STRETCH_ITEMS = 1024
# Larger corpora are cut into so many stretches, until their parts have the 128 MB and more that are read best. A worker
# gives back the rows of all items of a stretch at once.
NUM_STRETCHES = 64
MOST_STRETCH_BYTES, MOST_STRETCH_ITEMS = 512 * 2**20, 4096


@dataclass(frozen=True)
class NumberedItem:
    """A sequence to read and its index; None if the store has its id, so that it is read but not written."""

    item: SourceItem
    sequence_index: int | None

    def __str__(self) -> str:
        return str(self.item)


@dataclass(frozen=True, eq=False)
class ReadSequence:
    """A sequence that was read: its row of the table without the part, its location, and its skeleton."""

    row: Row
    skeleton: Skeleton


@dataclass(frozen=True, eq=False)
class ReadStretch:
    """Result of a chunk: the part, None if nothing was written, and an outcome per item."""

    part: PendingPart | None
    outcomes: tuple[ReadSequence | FormatError, ...]


def cut(items: Iterable[SourceItem]) -> Iterator[list[SourceItem]]:
    """The items in order, in stretches of a 64th of all files' bytes; a larger file is a stretch of its own.

    A stretch has 32 MiB at least and 512 MiB at most. The cut depends on the items alone. Sequences of one file come
    into one stretch, so that it is read once, unless they are more than 1,024 for each 32 MiB, or 4,096.
    """
    files = [(_size(path), list(of_file)) for path, of_file in groupby(items, key=lambda item: item.path)]
    wanted_bytes = sum(size for size, _ in files) // NUM_STRETCHES
    most_bytes = min(max(STRETCH_BYTES, wanted_bytes), MOST_STRETCH_BYTES)
    most_items = min(STRETCH_ITEMS * most_bytes // STRETCH_BYTES, MOST_STRETCH_ITEMS)
    stretch: list[SourceItem] = []
    num_bytes = 0
    for size, of_file in files:
        if stretch and num_bytes + size > most_bytes:
            yield stretch
            stretch, num_bytes = [], 0
        num_bytes += size
        for item in of_file:
            if len(stretch) == most_items:
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
    """Reads and encodes one sequence, or returns its error.

    Exceptions that readers don't handle are returned too (`unexpected`): one odd file must not end an ingest of a
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
