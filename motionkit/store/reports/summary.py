"""What is in a store, in numbers: sources, framerates, splits, captions, skeletons, sizes."""

from collections import Counter
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from motionkit.core.errors import StoreError
from motionkit.core.timegrid import format_fps
from motionkit.store.cache.folder import cache_bytes
from motionkit.store.reader import Store
from motionkit.store.schema import (
    FLOAT_COLUMNS,
    POSITION_BYTES_PER_JOINT,
    ROOT_TRANSLATION_BYTES,
    ROTATION_BYTES_PER_JOINT,
)

COUNTED_COLUMNS = (
    "source",
    "duration_seconds",
    "num_frames",
    "fps_numerator",
    "fps_denominator",
    "split",
    "source_format",
    "licence",
    "action",
    "skeleton",
    "num_joints",
    "has_rotations",
    "has_root_translation",
    "quality_flags",
)


@dataclass(frozen=True)
class SourceSummary:
    """One source's sequences; the mappings count sequences."""

    source: str
    num_sequences: int
    hours: float
    num_frames: int
    framerates: dict[str, int]
    splits: dict[str, int]
    formats: dict[str, int]
    licences: dict[str, int]
    num_actions: int
    num_captions: int
    num_captioned: int
    num_skeletons: int
    joints: dict[str, int]
    quality_flags: dict[str, int]


@dataclass(frozen=True)
class ColumnSize:
    """Bytes of a float column on disk, and as raw float32."""

    disk_bytes: int
    raw_bytes: int


@dataclass(frozen=True)
class StoreSummary:
    """A whole store; `disk_bytes` are those of the files that the manifest names, `cache_bytes` come on top."""

    path: str
    fingerprint: str
    tool: str
    num_sequences: int
    hours: float
    num_frames: int
    num_skeletons: int
    num_parts: int
    num_removed_segments: int
    disk_bytes: int
    cache_bytes: int
    columns: dict[str, ColumnSize]
    sources: tuple[SourceSummary, ...]

    @property
    def raw_bytes(self) -> int:
        """Bytes of all float columns as raw float32."""
        return sum(column.raw_bytes for column in self.columns.values())


def summarise(store: Store) -> StoreSummary:
    """Count what a store holds; reads the table of sequences and the parts' footers, no frames.

    Raises `StoreError` for a part that is missing or damaged.
    """
    sequences, manifest = _sequences(store), store.manifest
    return StoreSummary(
        path=str(store.path),
        fingerprint=store.fingerprint,
        tool=manifest.tool,
        num_sequences=manifest.num_sequences,
        hours=float(sequences["duration_seconds"].sum()) / 3600,
        num_frames=manifest.num_frames,
        num_skeletons=manifest.num_skeletons,
        num_parts=len(manifest.parts),
        num_removed_segments=manifest.num_removed_segments,
        disk_bytes=manifest.num_bytes,
        cache_bytes=cache_bytes(store.path, store.fingerprint),
        columns=_column_sizes(store, sequences),
        sources=tuple(_summarise_source(str(source), rows) for source, rows in sequences.groupby("source", sort=True)),
    )


def _sequences(store: Store) -> pd.DataFrame:
    """The columns that are counted, with `num_captions` for the captions, which take most of a whole table's memory."""
    rows = store.columns(*COUNTED_COLUMNS)
    rows["num_captions"] = np.asarray(pc.list_value_length(store.sequences_table["captions"]))
    return rows


def _summarise_source(source: str, rows: pd.DataFrame) -> SourceSummary:
    num_captions = rows["num_captions"]
    return SourceSummary(
        source=source,
        num_sequences=len(rows),
        hours=float(rows["duration_seconds"].sum()) / 3600,
        num_frames=int(rows["num_frames"].sum()),
        framerates=_framerates(rows),
        splits=_counts(rows["split"]),
        formats=_counts(rows["source_format"]),
        licences=_counts(rows["licence"]),
        num_actions=int(rows["action"][rows["action"] != ""].nunique()),
        num_captions=int(num_captions.sum()),
        num_captioned=int((num_captions > 0).sum()),
        num_skeletons=int(rows["skeleton"].nunique()),
        joints=_counts(rows["num_joints"]),
        quality_flags=dict(Counter(flag for flags in rows["quality_flags"] for flag in flags).most_common()),
    )


def _framerates(rows: pd.DataFrame) -> dict[str, int]:
    counts = Counter(
        Fraction(numerator, denominator)
        for numerator, denominator in zip(rows["fps_numerator"].tolist(), rows["fps_denominator"].tolist(), strict=True)
    )
    return {format_fps(fps): counts[fps] for fps in sorted(counts)}


def _counts(column: pd.Series) -> dict[str, int]:
    return {str(value): int(count) for value, count in column.value_counts().sort_index().items()}


def _column_sizes(store: Store, sequences: pd.DataFrame) -> dict[str, ColumnSize]:
    disk = dict.fromkeys(FLOAT_COLUMNS, 0)
    for name in store.manifest.parts:
        try:
            metadata = pq.read_metadata(store.part(name))
        except (pa.ArrowException, OSError) as error:
            raise StoreError(f"{error}: 'motionkit validate --store {store.path}' says what is damaged") from None
        for group in range(metadata.num_row_groups):
            for index in range(metadata.num_columns):
                column = metadata.row_group(group).column(index)
                owner = column.path_in_schema.split(".")[0]
                if owner in disk:
                    disk[owner] += column.total_compressed_size
    frames = sequences["num_frames"].astype("int64")
    joint_frames = frames * sequences["num_joints"]
    raw = {
        "joint_positions": POSITION_BYTES_PER_JOINT * joint_frames.sum(),
        "joint_rotations": ROTATION_BYTES_PER_JOINT * joint_frames[sequences["has_rotations"]].sum(),
        "root_translation": ROOT_TRANSLATION_BYTES * frames[sequences["has_root_translation"]].sum(),
    }
    return {name: ColumnSize(disk[name], int(raw[name])) for name in FLOAT_COLUMNS}
