"""Compares a store with its manifest, and its tables with its frames."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from motionkit.core.errors import StoreError
from motionkit.core.files import SEQUENCES_FILE
from motionkit.store.commit import TABLES, Manifest, check_sequences, read_manifest, read_skeletons, read_table
from motionkit.store.reader import ROWS_AT_ONCE, PartReader
from motionkit.store.schema import SEQUENCES, SKELETONS_FILE, part_number

# People give captions' ends in tenths of seconds, and releases of a data set differ by some frames.
CAPTION_TOLERANCE_SECONDS = 0.25


def faults(path: Path, on_file: Callable[[str], None] = lambda name: None) -> Iterator[str]:
    """One line for each fault of a store; `on_file` is called before each file is read.

    Raises `StoreError` where there is no store, its manifest is unreadable or of another format version, or a writer
    has changed it meanwhile.
    """
    manifest = read_manifest(path)
    for fault in _faults(path, manifest, on_file):
        if read_manifest(path) != manifest:  # then the file is one that a writer has replaced or deleted
            raise StoreError(f"the store {path} was written to while it was checked: check it again")
        yield fault


def _faults(path: Path, manifest: Manifest, on_file: Callable[[str], None]) -> Iterator[str]:
    tables: dict[str, pa.Table] = {}
    for name in TABLES:
        on_file(name)
        try:
            tables[name] = read_table(path, manifest, name)
        except (ValueError, OSError) as error:
            yield str(error)
    sequences = SEQUENCES.empty_table()  # where a table is damaged, nothing says what the parts should hold
    if len(tables) == 2:
        try:
            check_sequences(tables[SEQUENCES_FILE], manifest, read_skeletons(tables[SKELETONS_FILE]))
            sequences = tables[SEQUENCES_FILE]
        except ValueError as error:
            yield str(error)
    yield from _caption_faults(sequences)
    reader = PartReader(path, manifest.files)
    for name in manifest.parts:
        on_file(name)
        yield from _part_faults(path, reader, name, sequences.filter(pc.equal(sequences["part"], part_number(name))))


def _part_faults(path: Path, reader: PartReader, name: str, sequences: pa.Table) -> Iterator[str]:
    try:
        reader.checked_path(name)
    except StoreError:
        yield f"{name}: its sha256 is not the manifest's"
        return
    except OSError as error:
        missing = not (path / name).exists()
        yield f"{name}: it is missing" if missing else f"{name}: it cannot be read ({error.strerror or error})"
        return
    for batch in sequences.to_batches(max_chunksize=ROWS_AT_ONCE):
        for row in batch.to_pylist():
            try:
                frames = reader.read(row)
            except StoreError as error:
                yield f"{name}: {error}"
                continue
            for column, values in frames.items():
                if not np.isfinite(values).all():
                    frame = int(np.argwhere(~np.isfinite(values))[0][0])
                    yield f"{name}: {column} of sequence {row['sequence_id']!r} are not finite in frame {frame}"


def _caption_faults(sequences: pa.Table) -> Iterator[str]:
    """One line for each caption with invalid seconds, or beyond its motion's end; the motion can still be read."""
    captions = pc.list_flatten(sequences["captions"]).combine_chunks()
    row = np.asarray(pc.list_parent_indices(sequences["captions"]))
    start = np.asarray(captions.field("start_seconds"))
    end = np.asarray(pc.fill_null(captions.field("end_seconds"), np.inf))
    stop = np.asarray(pc.add(sequences["start_seconds"], sequences["duration_seconds"]))[row]
    is_inside = (start <= end) & (start < stop) & ((end == np.inf) | (end <= stop + CAPTION_TOLERANCE_SECONDS))
    for wrong in np.flatnonzero(~(is_inside & np.isfinite(start))):
        yield (
            f"{SEQUENCES_FILE}: sequence {sequences['sequence_id'][int(row[wrong])].as_py()!r}: a caption lasts from "
            f"{start[wrong]:g} to {end[wrong]:g} s, the motion ends at {stop[wrong]:g} s"
        )
