"""Is a store what its manifest says: checksums, counts, contiguous segments, finite frames, known skeletons."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.checksums import sha256_of
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
from motionkit.store.tables import read_table
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
        yield from _sequence_faults(sequences, manifest.next_sequence_index, tables.get(SKELETONS_FILE))
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
    table = read_table(content)
    if not table.schema.equals(table_schema(name, manifest.format_version)):
        return f"{name}: its columns are not those of this format version", None
    if table.num_rows != manifest.files[name].num_rows:
        return f"{name}: it has {table.num_rows} rows, the manifest says {manifest.files[name].num_rows}", None
    return "", table


def _count_faults(manifest: Manifest, sequences: pd.DataFrame | None) -> Iterator[str]:
    rows = sum(manifest.files[name].num_rows for name in manifest.parts)
    if rows < manifest.num_segments or (rows > manifest.num_segments and not _may_hold_removed(manifest)):
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


def _may_hold_removed(manifest: Manifest) -> bool:
    """Whether parts may hold segments of sequences that were removed."""
    return manifest.next_sequence_index > manifest.num_sequences


def _sequence_faults(sequences: pd.DataFrame, next_sequence_index: int, skeletons: pa.Table | None) -> Iterator[str]:
    # Without removals the numbers below the next one are as many as the sequences: 0, 1, 2 …
    steps = np.diff(sequences["sequence_index"], prepend=-1, append=next_sequence_index)
    if (steps < 1).any():
        yield f"{SEQUENCES_FILE}: sequence_index does not ascend from 0 to below {next_sequence_index}"
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
    if sha256_of(path / name) != entry.sha256:
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
    owner = np.full(len(keys), -1)
    if sequences is not None:
        owner, wrong = _owners(keys, sequences, may_hold_removed=_may_hold_removed(manifest))
        if wrong:
            yield f"{name}: {wrong}"
            return
    first_row = 0
    for group in range(part.num_row_groups):
        table = part.read_row_group(group).combine_chunks()
        rows = slice(first_row, first_row + table.num_rows)
        first_row += table.num_rows
        yield from _value_faults(name, table, keys.iloc[rows], owner[rows], sequences)


def _owners(keys: pd.DataFrame, sequences: pd.DataFrame, *, may_hold_removed: bool) -> tuple[np.ndarray, str]:
    """The row in `sequences` of each segment's sequence, −1 for a removed one; and what is wrong with their order.

    The text is empty where the segments of each sequence follow each other without a gap, and between sequences lie
    none but those of removed ones.
    """
    owner = np.full(len(keys), -1)
    counts, first_row = sequences["num_segments"].to_numpy(), sequences["first_row"].to_numpy()
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
    return f"row {stray[0]} is a segment too many of sequence {keys.iloc[stray[0], 0]}" if len(stray) else ""


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
    """Numbers per frame, and whether there are any, for each segment's sequence."""
    joints = owners["num_joints"].to_numpy().astype(np.int64)
    if column == "joint_positions":
        return 3 * joints, np.ones(len(joints), bool)
    if column == "joint_rotations":
        return 4 * joints, owners["has_rotations"].to_numpy()
    return np.full(len(joints), 3), owners["has_root_translation"].to_numpy()
