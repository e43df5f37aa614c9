"""Validates a store against its manifest: checksums, counts, contiguous segments, finite frames, known skeletons."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core.errors import StoreError
from motionkit.core.files import sha256_of
from motionkit.core.skeleton import Skeleton
from motionkit.store.manifest import FileEntry, Manifest, read_manifest
from motionkit.store.parts import read_footer
from motionkit.store.reader import read_committed_table
from motionkit.store.schema import (
    FLOAT_COLUMNS,
    KEY_COLUMNS,
    SEGMENT_FRAMES,
    SEGMENTS,
    SEGMENTS_FOLDER,
    SEQUENCES_FILE,
    SKELETONS_FILE,
    part_number,
)
from motionkit.store.table_checks import (
    caption_faults,
    count_faults,
    may_hold_removed,
    sequence_faults,
    skeleton_faults,
)


def faults(path: Path, on_file: Callable[[str], None] = lambda name: None) -> Iterator[str]:
    """One line for each fault of a store; `on_file` is called before each file is read.

    Raises `StoreError` where there is no store, its manifest is
    unreadable or of another format version, or a writer has changed it meanwhile.
    """
    manifest = read_manifest(path)
    for fault in _faults(path, manifest, on_file):
        if read_manifest(path) != manifest:  # then the file is one that a writer has replaced or deleted
            raise StoreError(f"the store {path} was written to while it was checked: check it again")
        yield fault


def _faults(path: Path, manifest: Manifest, on_file: Callable[[str], None]) -> Iterator[str]:
    if (path / SEGMENTS_FOLDER).is_symlink():
        yield f"{SEGMENTS_FOLDER}: it is a symbolic link to {str((path / SEGMENTS_FOLDER).readlink())!r}"
    tables: dict[str, pa.Table] = {}
    for name in (SEQUENCES_FILE, SKELETONS_FILE):
        on_file(name)
        try:
            table = read_committed_table(path, manifest, name)
        except (ValueError, OSError) as error:
            yield f"{name}: {error}"
            continue
        if table is None:
            state = "its sha256 is not the manifest's" if (path / name).exists() else "it is missing"
            yield f"{name}: {state}"
        else:
            tables[name] = table
    sequences, skeletons = tables.get(SEQUENCES_FILE), tables.get(SKELETONS_FILE)
    known: dict[str, Skeleton] | None = None
    if skeletons is not None:
        known = {}
        yield from skeleton_faults(skeletons, known)
    if sequences is not None:
        yield from sequence_faults(sequences, manifest, known)
        yield from caption_faults(sequences)
    yield from count_faults(manifest, sequences, skeletons)
    frame = None if sequences is None else sequences.to_pandas()
    for name in manifest.parts:
        on_file(name)
        chosen = None if frame is None else frame[frame["part"] == part_number(name)]
        yield from _part_faults(path, manifest, name, chosen)


def _part_faults(path: Path, manifest: Manifest, name: str, sequences: pd.DataFrame | None) -> Iterator[str]:
    try:
        fault = _file_fault(path / name, manifest.files[name])
        if fault:
            yield f"{name}: {fault}"
            return
        part = pq.ParquetFile(path / name, page_checksum_verification=True)
        keys = part.read(columns=list(KEY_COLUMNS)).to_pandas()
        owner = np.full(len(keys), -1)
        if sequences is not None:
            owner, wrong = _owners(keys, sequences, may_hold_removed=may_hold_removed(manifest))
            if wrong:
                yield f"{name}: {wrong}"
                return
        first_row = 0
        for group in range(part.num_row_groups):
            table = part.read_row_group(group).combine_chunks()
            rows = slice(first_row, first_row + table.num_rows)
            first_row += table.num_rows
            yield from _value_faults(name, table, keys.iloc[rows], owner[rows], sequences)
    except (pa.ArrowException, OSError, ValueError, IndexError) as error:
        yield f"{name}: it cannot be read ({' '.join(str(error).split())})"


def _file_fault(path: Path, entry: FileEntry) -> str:
    """The fault of a part as a file; empty if its checksums, columns and rows match the manifest."""
    if not path.is_file():
        return "it is not a file" if path.exists() else "it is missing"
    if sha256_of(path) != entry.sha256:
        return "its sha256 is not the manifest's"
    if path.stat().st_size != entry.num_bytes:
        return f"it has {path.stat().st_size} bytes, the manifest says {entry.num_bytes}"
    if entry.footer_sha256 and hashlib.sha256(read_footer(path)).hexdigest() != entry.footer_sha256:
        return "the sha256 of its footer is not the manifest's"
    part = pq.ParquetFile(path)
    if not part.schema_arrow.equals(SEGMENTS):
        return "its columns are not those of this format version"
    if part.metadata.num_rows != entry.num_rows:
        return f"it has {part.metadata.num_rows} rows, the manifest says {entry.num_rows}"
    return ""


def _owners(keys: pd.DataFrame, sequences: pd.DataFrame, *, may_hold_removed: bool) -> tuple[np.ndarray, str]:
    """The row in `sequences` of each segment's sequence, −1 for a removed one; and what is wrong with their order.

    The text is empty where the segments of each sequence follow each other without a gap, and between sequences lie
    none but those of removed ones.
    """
    owner = np.full(len(keys), -1)
    counts, first_row = (sequences[name].to_numpy().astype(np.int64) for name in ("num_segments", "first_row"))
    if (counts < 1).any():
        return owner, f"{SEQUENCES_FILE} says of a sequence that it has {counts.min()} segments"
    if counts.sum() > len(keys) or (counts.sum() < len(keys) and not may_hold_removed):
        return owner, f"it holds {len(keys)} segments, {SEQUENCES_FILE} says {counts.sum()}"
    gaps = np.append(first_row, len(keys)) - np.append(0, first_row + counts)
    if (gaps < 0).any() or (gaps.any() and not may_hold_removed):
        return owner, f"the sequences do not follow each other where {SEQUENCES_FILE} says"
    place = np.repeat(np.arange(len(sequences)), counts)
    segment = np.arange(len(place)) - np.repeat(np.cumsum(counts) - counts, counts)
    rows = np.repeat(first_row, counts) + segment
    owner[rows] = place
    start = segment * SEGMENT_FRAMES
    num_frames = np.minimum(SEGMENT_FRAMES, sequences["num_frames"].to_numpy()[place] - start)
    expected = np.stack([sequences["sequence_index"].to_numpy()[place], start, num_frames], axis=1)
    return owner, _misplaced(keys, owner, rows, expected)


def _misplaced(keys: pd.DataFrame, owner: np.ndarray, rows: np.ndarray, expected: np.ndarray) -> str:
    """Where the keys of `rows` are not those expected, or another row belongs to a sequence that is not removed."""
    found = keys.to_numpy()[rows]
    wrong = np.nonzero((found != expected).any(axis=1))[0]
    if len(wrong):
        first = int(wrong[0])
        of_row, of_table = (dict(zip(KEY_COLUMNS, each[first].tolist(), strict=True)) for each in (found, expected))
        return f"row {rows[first]} is {of_row}, expected {of_table}"
    stray = np.nonzero((owner < 0) & np.isin(keys["sequence_index"], expected[:, 0]))[0]
    return f"row {stray[0]} is an extra segment of sequence {keys.iloc[stray[0], 0]}" if len(stray) else ""


def _value_faults(
    name: str, table: pa.Table, rows: pd.DataFrame, owner: np.ndarray, sequences: pd.DataFrame | None
) -> Iterator[str]:
    for column in FLOAT_COLUMNS:
        lists = table[column].chunk(0)
        values = lists.values.to_numpy(zero_copy_only=True)
        bounds = lists.offsets.to_numpy()
        present = lists.is_valid().to_numpy(zero_copy_only=False)
        if not np.isfinite(values).all():
            bad = int(np.nonzero(~np.isfinite(values))[0][0])
            row = rows.iloc[int(np.searchsorted(bounds, bad, side="right")) - 1]
            yield (
                f"{name}: {column} of sequence {row['sequence_index']} is not finite in the segment that starts at "
                f"frame {row['start_frame']}"
            )
        if sequences is None:
            continue
        known = owner >= 0
        width, expected = _expected(column, sequences.iloc[np.where(known, owner, 0)])
        lengths = np.where(expected, width * rows["num_frames"].to_numpy(), 0)
        wrong = np.nonzero(known & ((np.diff(bounds) != lengths) | (present != expected)))[0]
        if len(wrong):
            row = rows.iloc[int(wrong[0])]
            yield (
                f"{name}: {column} of sequence {row['sequence_index']}, frame {row['start_frame']} holds "
                f"{int(np.diff(bounds)[wrong[0]])} numbers, expected {int(lengths[wrong[0]])}"
            )


def _expected(column: str, owners: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Values per frame, and whether there are any, for each segment's sequence."""
    joints = owners["num_joints"].to_numpy().astype(np.int64)
    if column == "joint_positions":
        return 3 * joints, np.ones(len(joints), bool)
    if column == "joint_rotations":
        return 4 * joints, owners["has_rotations"].to_numpy()
    return np.full(len(joints), 3), owners["has_root_translation"].to_numpy()
