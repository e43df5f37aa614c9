"""Is a store what its manifest says: checksums, counts, contiguous segments, finite frames, known skeletons."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.store import files
from motionkit.store.manifest import Manifest, read_committed, read_manifest
from motionkit.store.schema import (
    FLOAT_COLUMNS,
    KEY_COLUMNS,
    SEGMENT_FRAMES,
    SEGMENTS,
    SEQUENCES_FILE,
    SKELETONS_FILE,
    part_name,
    part_number,
)
from motionkit.store.versions import table_schema


def faults(path: Path, on_file: Callable[[str], None] = lambda name: None) -> Iterator[str]:
    """One line for each fault of a store, none where it is intact; `on_file` is told before each file is read.

    Raises `StoreError` where there is no store, or its manifest is unreadable or of another format version.
    """
    manifest = read_manifest(path)
    tables: dict[str, pa.Table] = {}
    for name in (SEQUENCES_FILE, SKELETONS_FILE):
        on_file(name)
        fault, table = _read_table(path, manifest, name)
        if table is None:
            yield fault
        else:
            tables[name] = table
    sequences = None
    if SEQUENCES_FILE in tables:
        sequences = tables[SEQUENCES_FILE].to_pandas()
        yield from _sequence_faults(sequences, tables.get(SKELETONS_FILE))
    yield from _count_faults(manifest, sequences)
    named = set(manifest.parts)
    if sequences is not None:
        for number in sorted(set(sequences["part"].tolist()) - {part_number(name) for name in named}):
            yield f"{SEQUENCES_FILE}: {part_name(number)} is referred to, but the manifest does not name it"
    for name in manifest.parts:
        on_file(name)
        chosen = None if sequences is None else sequences[sequences["part"] == part_number(name)]
        yield from _part_faults(path, manifest, name, chosen)


def _read_table(path: Path, manifest: Manifest, name: str) -> tuple[str, pa.Table | None]:
    if name not in manifest.files:
        return f"{name}: the manifest does not name it", None
    content = read_committed(path, name, manifest.files[name])
    if content is None:
        state = "its sha256 is not the manifest's" if (path / name).exists() else "it is missing"
        return f"{name}: {state}", None
    table = pq.read_table(pa.BufferReader(content))
    if not table.schema.equals(table_schema(name, manifest.format_version)):
        return f"{name}: its columns are not those of this format version", None
    if table.num_rows != manifest.files[name].num_rows:
        return f"{name}: it has {table.num_rows} rows, the manifest says {manifest.files[name].num_rows}", None
    return "", table


def _count_faults(manifest: Manifest, sequences: pd.DataFrame | None) -> Iterator[str]:
    rows = sum(manifest.files[name].num_rows for name in manifest.parts)
    if rows != manifest.num_segments:
        yield f"manifest.json: counts {manifest.num_segments} segments, the parts hold {rows}"
    if sequences is None:
        return
    for name, found, stated in (
        ("sequences", len(sequences), manifest.num_sequences),
        ("segments", int(sequences["num_segments"].sum()), manifest.num_segments),
        ("frames", int(sequences["num_frames"].sum()), manifest.num_frames),
    ):
        if found != stated:
            yield f"manifest.json: counts {stated} {name}, {SEQUENCES_FILE} says {found}"


def _sequence_faults(sequences: pd.DataFrame, skeletons: pa.Table | None) -> Iterator[str]:
    if not np.array_equal(sequences["sequence_index"], np.arange(len(sequences))):
        yield f"{SEQUENCES_FILE}: sequence_index does not count 0, 1, 2 …"
    for sequence_id in sequences["sequence_id"][sequences["sequence_id"].duplicated()]:
        yield f"{SEQUENCES_FILE}: the id {sequence_id!r} occurs more than once"
    rate = sequences["fps_numerator"] / sequences["fps_denominator"]
    wrong = {
        "fps is not fps_numerator / fps_denominator": ~np.isclose(rate, sequences["fps"], rtol=1e-12),
        "duration_seconds is not num_frames / fps": ~np.isclose(
            sequences["num_frames"] / rate, sequences["duration_seconds"], rtol=1e-12
        ),
        "num_segments does not fit num_frames": sequences["num_segments"]
        != -(-sequences["num_frames"] // SEGMENT_FRAMES),
    }
    if skeletons is not None:
        joints = {row["skeleton"]: len(row["joint_names"]) for row in skeletons.to_pylist()}
        wrong["its skeleton is not in skeletons.parquet"] = ~sequences["skeleton"].isin(list(joints))
        known = sequences["skeleton"].map(joints)
        wrong["num_joints is not its skeleton's"] = known.notna() & (known != sequences["num_joints"])
    for says, rows in wrong.items():
        for sequence_id in sequences["sequence_id"][np.asarray(rows)]:
            yield f"{SEQUENCES_FILE}: sequence {sequence_id!r}: {says}"


def _part_faults(path: Path, manifest: Manifest, name: str, sequences: pd.DataFrame | None) -> Iterator[str]:
    entry = manifest.files[name]
    if not (path / name).exists():
        yield f"{name}: it is missing"
        return
    if files.sha256_of(path / name) != entry.sha256:
        yield f"{name}: its sha256 is not the manifest's"
        return
    part = pq.ParquetFile(path / name)
    if not part.schema_arrow.equals(SEGMENTS):
        yield f"{name}: its columns are not those of this format version"
        return
    if part.metadata.num_rows != entry.num_rows:
        yield f"{name}: it has {part.metadata.num_rows} rows, the manifest says {entry.num_rows}"
        return
    keys = part.read(columns=list(KEY_COLUMNS)).to_pandas()
    if sequences is not None:
        wrong = _misplaced(keys, sequences)
        if wrong:
            yield f"{name}: {wrong}"
            return
    first_row = 0
    for group in range(part.num_row_groups):
        table = part.read_row_group(group).combine_chunks()
        rows = keys.iloc[first_row : first_row + table.num_rows]
        first_row += table.num_rows
        yield from _value_faults(name, table, rows, sequences)


def _misplaced(keys: pd.DataFrame, sequences: pd.DataFrame) -> str:
    """What is wrong with the order of segments, empty where each sequence's follow each other without a gap."""
    counts = sequences["num_segments"].to_numpy()
    if counts.sum() != len(keys):
        return f"it holds {len(keys)} segments, {SEQUENCES_FILE} says {counts.sum()}"
    owner = np.repeat(sequences["sequence_index"].to_numpy(), counts)
    first_row = np.cumsum(counts) - counts
    if not np.array_equal(first_row, sequences["first_row"]):
        return f"the sequences do not follow each other where {SEQUENCES_FILE} says"
    start = (np.arange(len(keys)) - np.repeat(first_row, counts)) * SEGMENT_FRAMES
    num_frames = np.minimum(SEGMENT_FRAMES, np.repeat(sequences["num_frames"].to_numpy(), counts) - start)
    expected = np.stack([owner, start, num_frames], axis=1)
    wrong = np.nonzero((keys.to_numpy() != expected).any(axis=1))[0]
    if not len(wrong):
        return ""
    row = int(wrong[0])
    found = dict(zip(KEY_COLUMNS, keys.iloc[row].tolist(), strict=True))
    return f"row {row} is {found}, expected {dict(zip(KEY_COLUMNS, expected[row].tolist(), strict=True))}"


def _value_faults(name: str, table: pa.Table, rows: pd.DataFrame, sequences: pd.DataFrame | None) -> Iterator[str]:
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
        width, expected = _expected(column, sequences.loc[rows["sequence_index"]])
        lengths = np.where(expected, width * rows["num_frames"].to_numpy(), 0)
        wrong = np.nonzero((np.diff(bounds) != lengths) | (present != expected))[0]
        if len(wrong):
            row = rows.iloc[int(wrong[0])]
            yield (
                f"{name}: {column} of sequence {row['sequence_index']}, frame {row['start_frame']} holds "
                f"{int(np.diff(bounds)[wrong[0]])} numbers, expected {int(lengths[wrong[0]])}"
            )


def _expected(column: str, owners: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Numbers per frame, and whether there are any, for each segment's sequence."""
    joints = owners["num_joints"].to_numpy().astype(np.int64)
    if column == "joint_positions":
        return 3 * joints, np.ones(len(joints), bool)
    if column == "joint_rotations":
        return 4 * joints, owners["has_rotations"].to_numpy()
    return np.full(len(joints), 3), owners["has_root_translation"].to_numpy()
