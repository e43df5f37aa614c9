"""Chunks of the sources, some megabytes each: a worker reads one and writes it as one part of the store."""

import os
import socket
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from motionkit.core.errors import FormatError, StoreError
from motionkit.core.skeleton import Skeleton
from motionkit.io.reading import read
from motionkit.io.registry import ReadOptions, SourceItem
from motionkit.store.commit import pending_part
from motionkit.store.parts import PartWriter, PendingPart
from motionkit.store.schema import MOTIONS_FOLDER, EncodedMotion, RefusedMotion, Row, encode

# A second of reading, and a part of about 10 MB: keeps all workers busy for small corpora.
CHUNK_BYTES, CHUNK_ITEMS = 32 << 20, 1024
# Larger corpora are cut into this number of chunks, until their parts have the 128 MB and more that are read best. A
# worker returns the rows of all items of a chunk at once.
NUM_CHUNKS = 64
MAX_CHUNK_BYTES, MAX_CHUNK_ITEMS = 512 << 20, 4096


@dataclass(frozen=True)
class NumberedItem:
    """A sequence to read and its index; None if the store has its id, so that it is read but not written."""

    item: SourceItem
    sequence_index: int | None


@dataclass(frozen=True, eq=False)
class ReadSequence:
    """A sequence that was read: its row of the table without the part, its location, and its skeleton."""

    row: Row
    skeleton: Skeleton


@dataclass(frozen=True, eq=False)
class ReadChunk:
    """Result of a chunk: the part, None if nothing was written, and an outcome per item."""

    part: PendingPart | None
    outcomes: tuple[ReadSequence | FormatError, ...]


def chunks_of(items: Iterable[SourceItem]) -> Iterator[list[SourceItem]]:
    """The items in order, in chunks of a 64th of all files' bytes; a larger file is a chunk of its own.

    A chunk has 32 MiB at least and 512 MiB at most. It depends on the items alone. Sequences of one file come into one
    chunk, so that it is read once, unless they are more than 1,024 for each 32 MiB, or 4,096.
    """
    files = [(_size(path), list(of_file)) for path, of_file in groupby(items, key=lambda item: item.path)]
    share = sum(size for size, _ in files) // NUM_CHUNKS
    max_bytes = min(max(CHUNK_BYTES, share), MAX_CHUNK_BYTES)
    max_items = min(CHUNK_ITEMS * max_bytes // CHUNK_BYTES, MAX_CHUNK_ITEMS)
    chunk: list[SourceItem] = []
    num_bytes = 0
    for size, of_file in files:
        if chunk and num_bytes + size > max_bytes:
            yield chunk
            chunk, num_bytes = [], 0
        num_bytes += size
        for item in of_file:
            if len(chunk) == max_items:
                yield chunk
                chunk, num_bytes = [], size
            chunk.append(item)
    if chunk:
        yield chunk


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def read_chunk(
    items: Sequence[NumberedItem], store: Path, options: ReadOptions, deadly: Container[int] = ()
) -> ReadChunk:
    """Read sequences and write those that have an index into one part of the store, under a pending name.

    A fault of a source is returned, so that it travels between processes like a result. The items at the positions
    `deadly` are faults, unread. Raises `OSError` where the part cannot be written, and `StoreError` where there is no
    such store.
    """
    if not (store / MOTIONS_FOLDER).is_dir():
        raise StoreError(f"there is no store {store} on {socket.gethostname()}: it must be where all machines see it")
    part = PartWriter(pending_part(store, items[0].sequence_index or 0))
    skeletons: dict[str, Skeleton] = {}
    outcomes: list[ReadSequence | FormatError] = []
    try:
        for position, each in enumerate(items):
            motion = worker_died(each.item) if position in deadly else read_or_fault(each.item, options)
            if isinstance(motion, FormatError):
                outcomes.append(motion)
                continue
            row = motion.row
            if each.sequence_index is not None:
                part_row = part.add(each.sequence_index, motion)
                row = {**row, "sequence_index": each.sequence_index, "part_row": part_row}
            skeleton = skeletons.setdefault(motion.skeleton.fingerprint, motion.skeleton)
            outcomes.append(ReadSequence(row, skeleton))
        return ReadChunk(part.finish(), tuple(outcomes))
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
        if os.path.lexists(item.path):
            return problem
        message = f"there is no such file on {socket.gethostname()}, but there was when the source was scanned: "
        message += "removed since, or not in a folder that all machines share"
        return FormatError(message, path=item.path, reason="not-visible")
    except RefusedMotion as refused:
        return FormatError(str(refused), path=item.path, reason=refused.reason)
    except Exception as error:
        text = f"{type(error).__name__}: {error}".splitlines()[0]
        return FormatError(f"the {item.format} reader failed: {text}", path=item.path, reason="unexpected")


def worker_died(item: SourceItem) -> FormatError:
    """The fault of a sequence whose reader ended its process."""
    message = "the process that read it ended without a word (killed, or out of memory?): --workers 1 shows where"
    return FormatError(message, path=item.path, reason="worker-died")
