"""Summary of a store: sources, framerates, splits, captions, sizes, skeletons and their layouts."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from motionkit.core.errors import StoreError
from motionkit.core.framerate import format_fps
from motionkit.store.cache import cache_bytes
from motionkit.store.reader import Store
from motionkit.store.schema import FRAME_COLUMNS

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
    "captions",
)
DURATION_EDGES = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0)


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
    durations: dict[str, int]


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
    num_removed: int
    disk_bytes: int
    cache_bytes: int
    columns: dict[str, ColumnSize]
    sources: tuple[SourceSummary, ...]

    @property
    def raw_bytes(self) -> int:
        """Bytes of all float columns as raw float32."""
        return sum(column.raw_bytes for column in self.columns.values())

    @property
    def licences(self) -> tuple[str, ...]:
        """The licences of all sequences, sorted; "not stated" for those without."""
        return tuple(sorted({name or "not stated" for source in self.sources for name in source.licences}))


def summarise(store: Store) -> StoreSummary:
    """Count what a store holds; reads the table of sequences and the parts' footers, no frames.

    Raises `StoreError` for a part that is missing or damaged.
    """
    sequences, manifest = store.sequences_table.select(COUNTED_COLUMNS), store.manifest
    return StoreSummary(
        path=str(store.path),
        fingerprint=store.fingerprint,
        tool=manifest.tool,
        num_sequences=manifest.num_sequences,
        hours=_hours(sequences),
        num_frames=store.num_frames,
        num_skeletons=len(store.skeletons),
        num_parts=len(manifest.parts),
        num_removed=manifest.num_removed,
        disk_bytes=manifest.num_bytes,
        cache_bytes=cache_bytes(store.path, store.fingerprint),
        columns=_column_sizes(store, sequences),
        sources=tuple(
            _summarise_source(source.as_py(), sequences.filter(pc.equal(sequences["source"], source)))
            # Arrow's own scalars: converting Python's would import pandas.
            for source in sorted(sequences["source"].unique(), key=lambda scalar: scalar.as_py())
        ),
    )


def _summarise_source(source: str, rows: pa.Table) -> SourceSummary:
    num_captions = pc.list_value_length(rows["captions"])
    fps = Counter(map(Fraction, rows["fps_numerator"].to_pylist(), rows["fps_denominator"].to_pylist()))
    return SourceSummary(
        source=source,
        num_sequences=rows.num_rows,
        hours=_hours(rows),
        num_frames=_total(rows["num_frames"]),
        framerates={format_fps(each): fps[each] for each in sorted(fps)},
        splits=_counts(rows["split"]),
        formats=_counts(rows["source_format"]),
        licences=_counts(rows["licence"]),
        num_actions=len(set(rows["action"].unique().to_pylist()) - {""}),
        num_captions=_total(num_captions),
        num_captioned=_total(pc.sign(num_captions)),
        num_skeletons=len(rows["skeleton"].unique()),
        joints=_counts(rows["num_joints"]),
        quality_flags=dict(Counter(pc.list_flatten(rows["quality_flags"]).to_pylist()).most_common()),
        durations=_durations(rows["duration_seconds"].to_pylist()),
    )


def _hours(rows: pa.Table) -> float:
    return float(pc.sum(rows["duration_seconds"], min_count=0).as_py()) / 3600


def _total(column: pa.ChunkedArray) -> int:
    return int(pc.sum(column, min_count=0).as_py())


def _durations(seconds: Sequence[float]) -> dict[str, int]:
    """Histogram of durations; bins include their lower edge."""
    edges = (0.0, *DURATION_EDGES, np.inf)
    between = (f"{low:g} to {high:g} s" for low, high in pairwise(DURATION_EDGES))
    names = [f"under {DURATION_EDGES[0]:g} s", *between, f"{DURATION_EDGES[-1]:g} s and more"]
    counts = np.histogram(seconds, edges)[0].tolist()
    return {name: count for name, count in zip(names, counts, strict=True) if count}


def _counts(column: pa.ChunkedArray) -> dict[str, int]:
    return {str(value): count for value, count in sorted(Counter(column.to_pylist()).items())}


def _column_sizes(store: Store, sequences: pa.Table) -> dict[str, ColumnSize]:
    disk = dict.fromkeys(FRAME_COLUMNS, 0)
    for name in store.manifest.parts:
        try:
            metadata = pq.read_metadata(store.path / name)
        except (pa.ArrowException, OSError) as error:
            raise StoreError(
                f"{store.path / name}: {error}: 'motionkit validate --store {store.path}' says what is damaged"
            ) from None
        for group in range(metadata.num_row_groups):
            for index in range(metadata.num_columns):
                column = metadata.row_group(group).column(index)
                owner = column.path_in_schema.split(".")[0]
                if owner in disk:
                    disk[owner] += column.total_compressed_size
    frames = sequences["num_frames"].cast(pa.int64())
    joint_frames = pc.multiply(frames, sequences["num_joints"])
    raw = {
        "joint_positions": 12 * _total(joint_frames),
        "local_rotations": 16 * _total(joint_frames.filter(sequences["has_rotations"])),
        "root_translation": 12 * _total(frames.filter(sequences["has_root_translation"])),
    }
    return {name: ColumnSize(disk[name], raw[name]) for name in FRAME_COLUMNS}
