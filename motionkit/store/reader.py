"""Reads a store: tables, single motions, many motions in order, SQL by duckdb without access to files."""

import atexit
import operator
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache, cached_property, lru_cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from motionkit.core import files
from motionkit.core.errors import StoreError, UsageError, counted
from motionkit.core.motion import Motion
from motionkit.core.progress import OnProgress, ignore
from motionkit.core.shapes import Float32, Int, Int64
from motionkit.store.commit import (
    TABLES,
    FileEntry,
    Manifest,
    check_sequences,
    damaged,
    read_manifest,
    read_skeletons,
    read_table,
)
from motionkit.store.schema import (
    FRAME_COLUMNS,
    KEY_COLUMNS,
    MOTIONS,
    SEQUENCES,
    EncodedMotion,
    frame_shapes,
    motion_from_row,
    part_name,
)

if TYPE_CHECKING:
    import duckdb
    import pandas as pd


# Arrow tables and datasets.
Views = Mapping[str, Any]
# How long to wait before interrupting duckdb again: between two statements it forgets an interrupt.
INTERRUPT_SECONDS = 0.05


def query(views: Views, sql: str) -> pa.Table:
    """Result of one SQL statement over the views as an Arrow table; a name that comes again gets _1, _2 …

    The statement can neither read nor write files, and what it creates is gone when it ends. Raises `UsageError` for
    anything but one reading statement, and with duckdb's words where it cannot run. Ctrl-C stops a statement that runs.
    """
    with _database(os.getpid()).cursor() as connection, ThreadPoolExecutor(1, "query") as thread:
        # Within duckdb, Ctrl-C would be ignored until the statement ends, or become an error of the statement.
        running = thread.submit(_query, connection, views, sql)
        try:
            return running.result()
        except KeyboardInterrupt:
            while not running.done():
                connection.interrupt()
                wait([running], INTERRUPT_SECONDS)
            raise


@cache
def _database(process: int) -> "duckdb.DuckDBPyConnection":
    """The empty database of a process, in memory, without access to files; a forked process cannot use its parent's."""
    import duckdb

    database = duckdb.connect()
    # The temporary directory is excepted from enable_external_access.
    database.execute("SET temp_directory = ''; SET enable_external_access = false; SET lock_configuration = true")
    atexit.register(_database.cache_clear)  # else duckdb's library reports a leak
    return database


def _query(connection: "duckdb.DuckDBPyConnection", views: Views, sql: str) -> pa.Table:
    import duckdb

    connection.begin()
    try:
        for name, view in views.items():
            connection.register(name, view)
        kinds = [statement.type for statement in connection.extract_statements(sql)]
        if len(kinds) != 1 or kinds[0] not in (duckdb.StatementType.SELECT, duckdb.StatementType.EXPLAIN):
            raise UsageError("one statement that only reads is expected: SELECT, FROM, WITH, DESCRIBE, SUMMARIZE …")
        return _with_unique_names(connection.sql(sql).to_arrow_table())
    except duckdb.Error as error:
        tables = ""
        if isinstance(error, duckdb.CatalogException):  # what duckdb suggests are tables of its own
            tables = " (the tables of a store are sequences, motions and skeletons)"
        raise UsageError(f"duckdb: {' '.join(str(error).split())}{tables}") from None
    finally:
        connection.rollback()


def _with_unique_names(table: pa.Table) -> pa.Table:
    # SELECT * over a join repeats names, and whoever reads columns by name would see one of them twice.
    counts: Counter[str] = Counter()
    names = []
    for name in table.column_names:
        names.append(f"{name}_{counts[name]}" if counts[name] else name)
        counts[name] += 1
    return table.rename_columns(names)


def conjunction(*conditions: str | None) -> str:
    """Combines conditions with AND, skipping None and empty ones; empty if there is none."""
    given = [condition for condition in conditions if condition]
    return given[0] if len(given) == 1 else " AND ".join(f"({condition})" for condition in given)


# An open part is its footer: about 500 bytes for each row group. A decoded row group is some megabytes.
KEPT_PARTS = 32
KEPT_ROW_GROUPS = 2
OPEN_ATTEMPTS = 5
ROWS_AT_ONCE = 1024
# Where a sequence lies in its store: what changes when it is copied into another one.
PLACE_COLUMNS = ("sequence_index", "part", "part_row")


class PartReader:
    """Owns the open parts and the decoded row groups of one committed state of a store; pickled without them.

    `fetch_part` downloads a part that is not in the store's folder.
    """

    def __init__(
        self, store: Path, entries: Mapping[str, FileEntry], fetch_part: Callable[[str], None] | None = None
    ) -> None:
        self._store = store
        self._entries = entries
        self._fetch_part = fetch_part
        self._intact: set[str] = set()
        # Not of methods: with a reader all that it keeps is freed at once.
        self._opened = lru_cache(KEPT_PARTS)(_open)
        self._decoded = lru_cache(KEPT_ROW_GROUPS)(_decode)

    def __reduce__(self) -> tuple[object, ...]:
        return PartReader, (self._store, self._entries, self._fetch_part)

    def read(
        self, row: Mapping[str, Any], *, rotations: bool = True
    ) -> dict[str, Float32[np.ndarray, "frames *channels"]]:
        """The frame arrays [num_frames, …] of a row of SEQUENCES; of the positions alone without `rotations`.

        Raises `StoreError` where the part is damaged, or gone since the store was opened.
        """
        try:
            frames = self._row(row, FRAME_COLUMNS if rotations else FRAME_COLUMNS[:1])
            return {
                name: _frames(frames, name, row["num_frames"], shape)
                for name, shape in frame_shapes(row, rotations=rotations).items()
            }
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise self._explained(row, error) from None

    def read_encoded(self, row: Mapping[str, Any]) -> pa.RecordBatch:
        """The row of MOTIONS of a row of SEQUENCES without its index, to be copied; raises as `read` does."""
        try:
            return self._row(row, FRAME_COLUMNS).drop_columns("sequence_index").to_batches()[0]
        except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
            raise self._explained(row, error) from None

    def checked_path(self, name: str) -> Path:
        """Path of a part, whose sha256 is compared with the manifest's the first time.

        Raises `StoreError` if it is damaged, `OSError` if it cannot be read.
        """
        path, entry = self._store / name, self._entries[name]
        if name in self._intact:
            return path
        if self._fetch_part and not path.exists():
            self._fetch_part(name)
        if path.stat().st_size != entry.num_bytes or files.sha256_of(path) != entry.sha256:
            raise damaged(self._store, f"{name}: its sha256 is not the manifest's")
        self._intact.add(name)
        return path

    def _row(self, row: Mapping[str, Any], columns: tuple[str, ...]) -> pa.Table:
        place = row["part_row"]
        file, starts = self._opened(self.checked_path(part_name(row["part"])))
        if not 0 <= place < starts[-1]:
            raise ValueError("the part has no such row")
        group = int(np.searchsorted(starts, place, side="right")) - 1
        frames = self._decoded(file, group, columns).slice(place - int(starts[group]), 1)
        for name in KEY_COLUMNS:
            if frames[name][0].as_py() != row[name]:
                raise ValueError(f"its {name} is not what the table of sequences says")
        return frames

    def _explained(self, row: Mapping[str, Any], error: Exception) -> StoreError:
        name = part_name(row["part"])
        if isinstance(error, FileNotFoundError):
            check_still_there(self._store, [name])
        return StoreError(
            f"the frames of sequence {row['sequence_id']!r} cannot be read from {name} "
            f"({' '.join(str(error).split())}): 'motionkit validate --store {self._store}' says what is damaged"
        )


def check_still_there(store: Path, parts: Iterable[str]) -> None:
    """Raise `StoreError` if a later state of the store doesn't use these parts, so that they were deleted."""
    if not set(parts) <= set(read_manifest(store).files):
        raise StoreError(
            f"the store {store} was written anew after it was opened (compacted, overwritten, or sequences "
            "removed): open it again"
        )


def _open(path: Path) -> tuple[pq.ParquetFile, Int64[np.ndarray, "row_groups_and_end"]]:
    """A part, and the first row of each of its row groups, with its number of rows at the end."""
    file = pq.ParquetFile(path)
    if not file.schema_arrow.equals(MOTIONS):
        raise ValueError("its columns are not those of a part")
    counts = [file.metadata.row_group(group).num_rows for group in range(file.metadata.num_row_groups)]
    return file, np.cumsum([0, *counts], dtype=np.int64)


def _decode(file: pq.ParquetFile, group: int, columns: tuple[str, ...]) -> pa.Table:
    return file.read_row_group(group, columns=[*KEY_COLUMNS, *columns]).combine_chunks()


def _frames(
    row: pa.Table, name: str, num_frames: int, shape: tuple[int, ...]
) -> Float32[np.ndarray, "frames *channels"]:
    """A frame array out of its channel-major list; raises `ValueError` for another number of values."""
    values = row[name].combine_chunks().flatten().to_numpy()
    if values.size != num_frames * np.prod(shape):
        raise ValueError(f"{name} are {values.size} numbers, expected {num_frames} frames of {shape}")
    return np.ascontiguousarray(values.reshape(-1, num_frames).T).reshape(num_frames, *shape)


class Store:
    """A committed state of a store, read only; it stays readable while a writer appends.

    Owns the manifest, the two small tables and the row groups that were decoded last. A sequence is known by its id or
    by its `sequence_index`; the indices ascend, with gaps where sequences were removed. Iterating gives the ids.

    >>> store = mk.Store.open("store")
    >>> len(store), list(store)[:2]
    (6, ['walk/0', 'walk/1'])
    >>> store["walk/0"].fps
    Fraction(60, 1)
    """

    def __init__(
        self,
        path: Path,
        manifest: Manifest,
        sequences: pa.Table,
        skeletons: pa.Table,
        on_progress: OnProgress = ignore,
        fetch_part: Callable[[str], None] | None = None,
    ) -> None:
        self.path = path
        self.on_progress = on_progress
        """Callback for long work on the store, such as building a cache."""
        self.manifest = manifest
        self.sequences_table = sequences
        self.skeletons_table = skeletons
        self.skeletons = read_skeletons(skeletons)
        """Skeletons by fingerprint."""
        self._parts = PartReader(path, manifest.files, fetch_part)
        check_sequences(sequences, manifest, self.skeletons)

    @classmethod
    def open(cls, path: Path | str, *, on_progress: OnProgress = ignore) -> "Store":
        """Open a store, also one of the Hub (`hf://datasets/OWNER/NAME`), whose parts are downloaded as they are read.

        `on_progress` is called while caches are built from it. Raises `StoreError` where there is none, or it is
        damaged or of another format version; `HubError` where the Hub cannot be asked.
        """
        fetch_part = None
        if str(path).startswith("hf://"):
            from motionkit.store.hub import fetch_tables, parse_address  # deferred: few stores are of the Hub

            path, fetch_part = fetch_tables(parse_address(str(path)))
        path = Path(path)
        fault: Exception
        for _ in range(OPEN_ATTEMPTS):
            manifest = read_manifest(path)
            try:
                sequences, skeletons = (read_table(path, manifest, name) for name in TABLES)
                return cls(path, manifest, sequences, skeletons, on_progress, fetch_part)
            except ValueError as error:
                raise damaged(path, error) from None
            except FileNotFoundError as error:  # a writer may have committed since the manifest was read
                fault = error
        raise damaged(path, fault)

    @property
    def fingerprint(self) -> str:
        """Hex sha256 of the manifest: equal for equal stores."""
        return self.manifest.fingerprint

    @property
    def num_sequences(self) -> int:
        """Number of sequences."""
        return self.manifest.num_sequences

    @property
    def num_frames(self) -> int:
        """Number of frames of all sequences."""
        return int(pc.sum(self.sequences_table["num_frames"], min_count=0).as_py())

    @cached_property
    def sequences(self) -> "pd.DataFrame":
        """One row per sequence, labelled by `sequence_index`, ascending (columns: motionkit.store.SEQUENCES)."""
        return self.columns(*SEQUENCES.names)

    def columns(self, *names: str) -> "pd.DataFrame":
        """Some columns of `sequences`; preferable for large stores."""
        import pandas as pd

        frame: pd.DataFrame = self.sequences_table.select(names).to_pandas()
        frame.index = pd.Index(self._indices)
        return frame

    @cached_property
    def _indices(self) -> Int64[np.ndarray, "sequences"]:
        return np.asarray(self.sequences_table["sequence_index"], np.int64)

    def rows_of(self, indices: Int[np.ndarray, "chosen"]) -> Int64[np.ndarray, "chosen"]:
        """Rows of `sequences_table` for sequence indices; raises `StoreError` for one that the store does not hold."""
        rows = np.searchsorted(self._indices, indices).astype(np.int64)
        known = rows < self.num_sequences
        known[known] = self._indices[rows[known]] == indices[known]
        if not known.all():
            held = f"from {self._indices[0]} to {self._indices[-1]}" if self.num_sequences else "none"
            raise StoreError(f"the store {self.path} holds no sequence {indices[~known][0]}: its indices are {held}")
        return rows

    def index_of(self, sequence_id: str) -> int:
        """Index of a sequence by its id; raises `StoreError` for an id that the store does not hold."""
        ids = self.sequences_table["sequence_id"]
        row = pc.index(ids, sequence_id).as_py()
        if row < 0:
            alike: list[str] = ids.filter(pc.ends_with(ids, f"/{sequence_id}")).to_pylist()
            hint = f" (did you mean {alike[0]}?)" if alike else ""
            raise StoreError(f"the store {self.path} holds no sequence {sequence_id!r}{hint}")
        return int(self._indices[row])

    def read(self, sequence: int | np.integer | str, *, rotations: bool = True) -> Motion:
        """One motion by index or id; without `rotations` only positions are decoded.

        Raises `StoreError` for a sequence that the store does not hold, or a part that cannot be read; `UsageError` for
        what is neither index nor id.
        """
        try:
            index = self.index_of(sequence) if isinstance(sequence, str) else operator.index(sequence)
        except TypeError:
            raise UsageError(
                f"a store gives one motion by its id or its sequence_index, not by a {type(sequence).__name__}: "
                "read_many gives several"
            ) from None
        row = self.sequences_table.slice(self.rows_of(np.array([index]))[0], 1).to_pylist()[0]
        frames = self._parts.read(row, rotations=rotations)
        return motion_from_row(row, self.skeletons[row["skeleton"]], frames)

    def __getitem__(self, sequence: int | str) -> Motion:
        """One motion by id or index, as `read` gives it."""
        return self.read(sequence)

    def __len__(self) -> int:
        return self.num_sequences

    def __iter__(self) -> Iterator[str]:
        """The ids of the sequences, in order of their indices."""
        ids: list[str] = self.sequences_table["sequence_id"].to_pylist()
        return iter(ids)

    def __contains__(self, sequence_id: object) -> bool:
        return isinstance(sequence_id, str) and pc.index(self.sequences_table["sequence_id"], sequence_id).as_py() >= 0

    def read_many(self, sequences: Iterable[int | np.integer | str], *, rotations: bool = True) -> Iterator[Motion]:
        """Motions in the given order; in ascending order of index every row group is decoded once."""
        for sequence in sequences:
            yield self.read(sequence, rotations=rotations)

    def read_encoded(self, sequences: Int[np.ndarray, "chosen"]) -> Iterator[EncodedMotion]:
        """Sequences by index as they are stored, to be copied: nothing is measured again."""
        rows = self.sequences_table.take(self.rows_of(sequences))
        for batch in rows.to_batches(max_chunksize=ROWS_AT_ONCE):
            for row in batch.to_pylist():
                placeless = {name: value for name, value in row.items() if name not in PLACE_COLUMNS}
                yield EncodedMotion(placeless, self.skeletons[row["skeleton"]], self._parts.read_encoded(row))

    def query(self, sql: str) -> pa.Table:
        """Result of one SQL statement over `sequences`, `motions`, `skeletons`; raises `UsageError` for bad SQL."""
        views: dict[str, Any] = {"sequences": self.sequences_table, "skeletons": self.skeletons_table}
        try:
            # Only where the statement names them: the parts are read to compare their checksums.
            if "motions" in sql.lower():
                views["motions"] = self._motions()
            return query(views, sql)
        except (pa.ArrowException, OSError) as error:
            if isinstance(error, FileNotFoundError):
                check_still_there(self.path, self.manifest.parts)
            raise StoreError(f"{error}: 'motionkit validate --store {self.path}' says what is damaged") from None

    def _motions(self) -> Any:
        import pyarrow.dataset as ds

        parts = [str(self._parts.checked_path(name)) for name in self.manifest.parts]
        if not parts:
            return MOTIONS.empty_table()
        # The frames of removed sequences are in the parts until the store is compacted.
        return ds.dataset(parts, schema=MOTIONS).filter(
            pc.field("sequence_index").isin(self.sequences_table["sequence_index"])
        )

    def sql(self, sql: str) -> "pd.DataFrame":
        """Result of one SQL statement as a pandas table; `query` gives the same as an Arrow table.

        The tables are `sequences`, `motions` and `skeletons` (docs/store.md). Raises `UsageError` for bad SQL.

        >>> mk.Store.open("store").sql("SELECT fps, count(*) AS takes FROM sequences GROUP BY fps ORDER BY fps")
            fps  takes
        0  30.0      3
        1  60.0      3
        """
        frame: pd.DataFrame = self.query(sql).to_pandas()
        return frame

    def select(self, where: str | None = None) -> Int64[np.ndarray, "selected"]:
        """Indices of the sequences for which a SQL condition over the table of sequences holds, ascending.

        Raises `UsageError` that names the condition.
        """
        if where is None:
            return self._indices.copy()
        try:
            chosen = self.query(f"SELECT sequence_index FROM sequences WHERE ({where}) ORDER BY sequence_index")
        except UsageError as error:
            raise UsageError(f"the condition {where!r} is not valid: {error}") from None
        return np.asarray(chosen["sequence_index"], np.int64)

    def select_some(self, where: str | None = None) -> Int64[np.ndarray, "selected"]:
        """As `select`, but raises `UsageError` if no sequence is selected."""
        indices = self.select(where)
        if not len(indices):
            fault = f"no sequence of {self.path} satisfies {where!r}" if where else f"{self.path} is empty"
            raise UsageError(f"{fault} ({self._remedy(where or '')})")
        return indices

    def _remedy(self, where: str) -> str:
        # A store of captures that came without splits is asked for one by every recipe.
        if "split" in where and not any(self.sequences_table["split"].unique().to_pylist()):
            by = "" if all(self.sequences_table["subject"].unique().to_pylist()) else " --by sequence_id"
            return f"none is in a split yet: motionkit split{by} --store {self.path} makes train, val and test"
        return f"motionkit info --store {self.path} says what it holds"

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, {counted(self.num_sequences, 'sequence')}, {self.num_frames:,} frames)"

    def _repr_html_(self) -> str:
        """Summary by source, framerate and split, for notebooks."""
        counted = self.sql(
            "SELECT source, fps, split, count(*) AS sequences, round(sum(duration_seconds) / 60, 1) AS minutes "
            "FROM sequences GROUP BY ALL ORDER BY ALL"
        )
        return f"<p>{escape(repr(self))}</p>{counted.to_html(index=False, max_rows=40)}"
