"""Reading a store: tables, single motions, many motions in order, SQL."""

from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from jaxtyping import Float32, Int64

from motionkit.errors import StoreError
from motionkit.motion import Motion
from motionkit.skeleton import Skeleton
from motionkit.store import codec
from motionkit.store.manifest import Manifest, read_committed, read_manifest
from motionkit.store.schema import (
    FLOAT_COLUMNS,
    FORMAT_VERSION,
    KEY_COLUMNS,
    SEGMENTS,
    SEQUENCES_FILE,
    SKELETONS_FILE,
    part_name,
)
from motionkit.store.versions import upgraded

if TYPE_CHECKING:
    import pandas as pd

OPEN_ATTEMPTS = 5


class Store:
    """A committed state of a store, read only; it stays readable while a writer appends.

    Owns the manifest, the two small tables and the row group that was decoded last.
    """

    def __init__(self, path: Path, manifest: Manifest, sequences: pa.Table, skeletons: pa.Table) -> None:
        self.path = path
        self.manifest = manifest
        self.sequences_table = sequences
        self.skeletons_table = skeletons
        self._segments = _SegmentReader(path)

    @classmethod
    def open(cls, path: Path | str) -> "Store":
        """Open a store; raises `StoreError` where there is none, or it is damaged or of another format version."""
        path = Path(path)
        for _ in range(OPEN_ATTEMPTS):
            manifest = read_manifest(path)
            sequences = _read_table(path, manifest, SEQUENCES_FILE)
            skeletons = _read_table(path, manifest, SKELETONS_FILE)
            if sequences is not None and skeletons is not None:
                return cls(path, manifest, sequences, skeletons)
        raise StoreError(
            f"the tables of the store {path} are not those that its manifest names: "
            f"'motionkit validate --store {path}' says which; restore them from a copy or ingest again"
        )

    @property
    def fingerprint(self) -> str:
        """Hex sha256 of the manifest: equal for equal stores."""
        return self.manifest.fingerprint

    @property
    def num_sequences(self) -> int:
        """Number of sequences."""
        return self.manifest.num_sequences

    @cached_property
    def sequences(self) -> "pd.DataFrame":
        """One row per sequence, in order of `sequence_index` (columns: motionkit.store.schema.SEQUENCES)."""
        frame: pd.DataFrame = self.sequences_table.to_pandas()
        return frame

    @cached_property
    def skeletons(self) -> dict[str, Skeleton]:
        """Skeletons by fingerprint."""
        return {row["skeleton"]: codec.skeleton_from_row(row) for row in self.skeletons_table.to_pylist()}

    def index_of(self, sequence_id: str) -> int:
        """Index of a sequence by its id; raises `StoreError` for an id that the store does not hold."""
        index = pc.index(self.sequences_table["sequence_id"], sequence_id).as_py()
        if index < 0:
            raise StoreError(f"the store {self.path} holds no sequence {sequence_id!r}")
        return int(index)

    def read(self, sequence: int | np.integer | str, *, rotations: bool = True) -> Motion:
        """One motion by index or id; without `rotations` only positions are decoded.

        Raises `StoreError` for a sequence that the store does not hold, or a part that cannot be read.
        """
        index = self.index_of(sequence) if isinstance(sequence, str) else int(sequence)
        if not 0 <= index < self.num_sequences:
            raise StoreError(f"the store {self.path} holds sequences 0 … {self.num_sequences - 1}, not {index}")
        row = self.sequences_table.slice(index, 1).to_pylist()[0]
        skeleton = self.skeletons[row["skeleton"]]
        wanted: dict[str, tuple[int, ...]] = {"joint_positions": (skeleton.num_joints, 3)}
        if rotations and row["has_rotations"]:
            wanted["joint_rotations"] = (skeleton.num_joints, 4)
        if rotations and row["has_root_translation"]:
            wanted["root_translation"] = (3,)
        frames = self._segments.read(row, wanted, decode=FLOAT_COLUMNS if rotations else FLOAT_COLUMNS[:1])
        return codec.motion_from_row(
            row,
            skeleton,
            frames["joint_positions"],
            frames.get("joint_rotations"),
            frames.get("root_translation"),
        )

    def read_many(self, sequences: Iterable[int | np.integer | str], *, rotations: bool = True) -> Iterator[Motion]:
        """Motions in the order asked for; in ascending order of index every row group is decoded once."""
        for sequence in sequences:
            yield self.read(sequence, rotations=rotations)

    def query(self, sql: str) -> pa.Table:
        """Result of one SQL statement over `sequences`, `segments`, `skeletons`; raises `UsageError` for bad SQL."""
        from motionkit.store.sql import query

        parts = [str(self.path / name) for name in self.manifest.parts]
        segments = ds.dataset(parts, schema=SEGMENTS, format="parquet") if parts else SEGMENTS.empty_table()
        views = {"sequences": self.sequences_table, "segments": segments, "skeletons": self.skeletons_table}
        try:
            return query(views, sql)
        except (pa.ArrowException, OSError) as error:
            raise StoreError(f"{error}: 'motionkit validate --store {self.path}' says what is damaged") from None

    def select(self, where: str | None = None) -> Int64[np.ndarray, "selected"]:
        """Indices of the sequences for which a SQL condition over the table of sequences holds, ascending."""
        if where is None:
            return np.arange(self.num_sequences)
        chosen = self.query(f"SELECT sequence_index FROM sequences WHERE ({where}) ORDER BY sequence_index")
        return np.asarray(chosen["sequence_index"], np.int64)

    def __repr__(self) -> str:
        counts = self.manifest
        return f"Store({str(self.path)!r}, {counts.num_sequences} sequences, {counts.num_frames} frames)"


def _read_table(store: Path, manifest: Manifest, name: str) -> pa.Table | None:
    """A table as the manifest names it; None where a writer has committed since the manifest was read."""
    if name not in manifest.files:
        raise StoreError(f"the manifest of the store {store} does not name {name}: restore it from a copy")
    content = read_committed(store, name, manifest.files[name])
    if content is None:
        return None
    table = pq.read_table(pa.BufferReader(content))
    return (table if manifest.format_version == FORMAT_VERSION else upgraded(table, name)).combine_chunks()


class _SegmentReader:
    """Decodes segments of parts; keeps the last part's footer and the last row group."""

    def __init__(self, store: Path) -> None:
        self._store = store
        self._part = -1
        self._file: pq.ParquetFile | None = None
        self._row_group_starts = np.zeros(1, np.int64)
        self._decoded: tuple[int, int, tuple[str, ...]] | None = None
        self._table: pa.Table | None = None

    def read(
        self, row: dict[str, Any], wanted: dict[str, tuple[int, ...]], decode: tuple[str, ...]
    ) -> dict[str, Float32[np.ndarray, "frames *channels"]]:
        """Arrays [num_frames, *shape] of the wanted columns of one sequence; `decode` are the columns to keep."""
        out = {name: np.empty((row["num_frames"], *shape), np.float32) for name, shape in wanted.items()}
        try:
            self._fill(row, out, decode)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise StoreError(
                f"the frames of sequence {row['sequence_id']!r} cannot be read from {part_name(row['part'])} "
                f"({error}): 'motionkit validate --store {self._store}' says what is damaged"
            ) from None
        return out

    def _fill(
        self, row: dict[str, Any], out: dict[str, Float32[np.ndarray, "frames *channels"]], decode: tuple[str, ...]
    ) -> None:
        first, last = row["first_row"], row["first_row"] + row["num_segments"]
        self._open(row["part"])
        starts = self._row_group_starts
        while first < last:
            group = int(np.searchsorted(starts, first, side="right")) - 1
            table = self._row_group(group, decode)
            stop = min(last, int(starts[group + 1]))
            _copy_segments(table.slice(first - int(starts[group]), stop - first), row["sequence_index"], out)
            first = stop

    def _open(self, part: int) -> None:
        if part == self._part and self._file is not None:
            return
        self._file = pq.ParquetFile(self._store / part_name(part))
        metadata = self._file.metadata
        counts = [metadata.row_group(group).num_rows for group in range(metadata.num_row_groups)]
        self._row_group_starts = np.cumsum([0, *counts])
        self._part = part

    def _row_group(self, group: int, columns: tuple[str, ...]) -> pa.Table:
        if group + 1 >= len(self._row_group_starts):
            raise ValueError("the part ends before the sequence does")
        key = (self._part, group, columns)
        if self._table is None or self._decoded != key:
            assert self._file is not None
            self._table = self._file.read_row_group(group, columns=[*KEY_COLUMNS, *columns]).combine_chunks()
            self._decoded = key
        return self._table


def _copy_segments(
    table: pa.Table, sequence_index: int, out: dict[str, Float32[np.ndarray, "frames *channels"]]
) -> None:
    """Copy whole segments into `out`; raises `ValueError` where they are not those of the sequence."""
    owner, start, count = (table[name].to_numpy() for name in KEY_COLUMNS)
    if (owner != sequence_index).any():
        raise ValueError(f"segments of sequence {owner[owner != sequence_index][0]} where {sequence_index}'s should be")
    for name, target in out.items():
        column = table[name].chunk(0)
        values, bounds = column.values.to_numpy(zero_copy_only=True), column.offsets.to_numpy()
        for i in range(len(start)):
            num_frames = int(count[i])
            frames = target[start[i] : start[i] + num_frames]
            codec.write_frames(values[bounds[i] : bounds[i + 1]], num_frames, frames)
