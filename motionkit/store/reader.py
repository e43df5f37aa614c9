"""Reads a store: tables, single motions, many motions in order, SQL."""

import operator
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from motionkit.core.errors import StoreError, UsageError
from motionkit.core.motion import Motion
from motionkit.core.progress import OnProgress, ignore
from motionkit.core.shapes import Int, Int64
from motionkit.store import codec
from motionkit.store.codec import EncodedMotion
from motionkit.store.manifest import Manifest, read_committed, read_manifest
from motionkit.store.parts import SegmentReader, check_still_there
from motionkit.store.schema import (
    FLOAT_COLUMNS,
    PLACE_COLUMNS,
    SEGMENTS,
    SEQUENCES,
    SEQUENCES_FILE,
    SKELETONS,
    SKELETONS_FILE,
)
from motionkit.store.sql import UnknownTable, query
from motionkit.store.table_checks import require_sound


def read_table(content: bytes, columns: Sequence[str] | None = None) -> pa.Table:
    """The table of a Parquet file's content, or some columns of it; raises what pyarrow raises.

    One thread reads it. Arrow's own threads would keep the content for some milliseconds after the call, and where one
    of them lets go of a Python object while the interpreter ends, the process aborts: "terminate called without an
    active exception" (apache/arrow issues 36389 and 49942). One thread is quicker for such tables, too.
    """
    return pq.ParquetFile(pa.BufferReader(content)).read(columns=columns, use_threads=False)


def open_table(store: Path, manifest: Manifest, name: str, columns: Sequence[str] | None = None) -> pa.Table | None:
    """A table as the manifest names it; None where no file is that one, as after a commit that came in between.

    Raises `StoreError` where its rows or columns are not what they should be.
    """
    try:
        return read_committed_table(store, manifest, name, columns)
    except ValueError as error:
        raise StoreError(
            f"{store / name} is damaged ({error}): restore the store from a copy, or ingest the sources into a new one"
        ) from None


def read_committed_table(
    store: Path, manifest: Manifest, name: str, columns: Sequence[str] | None = None
) -> pa.Table | None:
    """A table as the manifest names it; None where no file is that one.

    Raises `ValueError` for a table with other columns or another number of rows than it should have, and for what is
    no Parquet.
    """
    entry = manifest.files.get(name)
    if entry is None:
        raise ValueError("the manifest does not name it")
    content = read_committed(store, name, entry)
    if content is None:
        return None
    try:
        found = pq.read_schema(pa.BufferReader(content))
        table = read_table(content, columns)
        table.validate(full=True)  # texts that are no UTF-8, lists that leave their values
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ValueError(f"it cannot be read as Parquet ({' '.join(str(error).split())})") from None
    if not found.equals({SEQUENCES_FILE: SEQUENCES, SKELETONS_FILE: SKELETONS}[name]):
        raise ValueError("its columns are not those of this format version")
    if table.num_rows != entry.num_rows:
        raise ValueError(f"it has {table.num_rows} rows, the manifest says {entry.num_rows}")
    return table


def not_committed(store: Path) -> StoreError:
    """The error if `read_committed_table` repeatedly finds none."""
    return StoreError(
        f"the tables of the store {store} are not those that its manifest names: "
        f"'motionkit validate --store {store}' says which; restore them from a copy or ingest again"
    )


if TYPE_CHECKING:
    import pandas as pd

OPEN_ATTEMPTS = 5
ROWS_AT_ONCE = 1024


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
    ) -> None:
        self.path = path
        self.on_progress = on_progress
        """Callback for long work on the store, such as building a cache."""
        self.manifest = manifest
        self.sequences_table = sequences
        self.skeletons_table = skeletons
        self.skeletons = require_sound(path, manifest, sequences, skeletons)
        """Skeletons by fingerprint."""
        self._segments = SegmentReader(path, manifest.files)

    @classmethod
    def open(cls, path: Path | str, *, on_progress: OnProgress = ignore) -> "Store":
        """Open a store, also one of the Hub (`hf://datasets/OWNER/NAME`), which is fetched into the Hub's cache.

        `on_progress` is called while caches are built from it. Raises `StoreError` where there
        is none, or it is damaged or of another format version; `HubError` where the Hub cannot be asked.
        """
        if str(path).startswith("hf://"):
            from motionkit.store.hub import fetch_store, parse_address  # deferred: few stores are of the Hub

            path = fetch_store(parse_address(str(path)))
        path = Path(path)
        for _ in range(OPEN_ATTEMPTS):
            manifest = read_manifest(path)
            sequences = open_table(path, manifest, SEQUENCES_FILE)
            skeletons = open_table(path, manifest, SKELETONS_FILE)
            if sequences is not None and skeletons is not None:
                return cls(path, manifest, sequences.combine_chunks(), skeletons, on_progress)
        raise not_committed(path)

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
        """One row per sequence, labelled by `sequence_index`, ascending (columns: motionkit.store.schema.SEQUENCES)."""
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
                skeleton = self.skeletons[row["skeleton"]]
                widths = {"joint_positions": 3 * skeleton.num_joints}
                if row["has_rotations"]:
                    widths["joint_rotations"] = 4 * skeleton.num_joints
                if row["has_root_translation"]:
                    widths["root_translation"] = 3
                placeless = {name: value for name, value in row.items() if name not in PLACE_COLUMNS}
                yield EncodedMotion(placeless, skeleton, self._segments.read_runs(row, widths))

    def query(self, sql: str) -> pa.Table:
        """Result of one SQL statement over `sequences`, `segments`, `skeletons`; raises `UsageError` for bad SQL."""
        views: dict[str, Any] = {"sequences": self.sequences_table, "skeletons": self.skeletons_table}
        try:
            # Only where they are asked for: a dataset looks at each of its files.
            if "segments" in sql.lower():
                views["segments"] = self._segments_dataset()
            return query(views, sql)
        except UnknownTable as error:
            raise UsageError(f"{error}; the tables of a store are sequences, segments and skeletons") from None
        except FileNotFoundError as error:
            check_still_there(self.path, self.manifest.parts)
            raise StoreError(f"{error}: 'motionkit validate --store {self.path}' says what is missing") from None
        except (pa.ArrowException, OSError) as error:
            raise StoreError(f"{error}: 'motionkit validate --store {self.path}' says what is damaged") from None

    def part(self, name: str) -> Path:
        """Path of a part whose footer is what the manifest says; raises `StoreError` where it is damaged."""
        return self._segments.checked_part(name)

    def sql(self, sql: str) -> "pd.DataFrame":
        """Result of one SQL statement as a pandas table; `query` gives the same as an Arrow table.

        The tables are `sequences`, `segments` and `skeletons` (docs/store.md). Raises `UsageError` for bad SQL.

        >>> mk.Store.open("store").sql("SELECT fps, count(*) AS takes FROM sequences GROUP BY fps ORDER BY fps")
            fps  takes
        0  30.0      3
        1  60.0      3
        """
        frame: pd.DataFrame = self.query(sql).to_pandas()
        return frame

    def _segments_dataset(self) -> Any:
        import pyarrow.dataset as ds  # which imports pandas: a third of a second that no worker of an ingest needs

        parts = [str(self.part(name)) for name in self.manifest.parts]
        if not parts:
            return SEGMENTS.empty_table()
        checked = ds.ParquetFragmentScanOptions(page_checksum_verification=True)
        pages = ds.ParquetFileFormat(default_fragment_scan_options=checked)
        segments = ds.dataset(parts, schema=SEGMENTS, format=pages)
        if not self.manifest.num_removed_segments:
            return segments
        return segments.filter(pc.field("sequence_index").isin(self.sequences_table["sequence_index"]))

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
        counts = self.manifest
        return f"Store({str(self.path)!r}, {counts.num_sequences} sequences, {counts.num_frames} frames)"

    def _repr_html_(self) -> str:
        """Summary by source, framerate and split, for notebooks."""
        counted = self.sql(
            "SELECT source, fps, split, count(*) AS sequences, round(sum(duration_seconds) / 60, 1) AS minutes "
            "FROM sequences GROUP BY ALL ORDER BY ALL"
        )
        return f"<p>{escape(repr(self))}</p>{counted.to_html(index=False, max_rows=40)}"
