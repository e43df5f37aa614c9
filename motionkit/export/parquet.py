"""A Parquet data set with a card: one self-contained row per sequence, for `datasets`, pandas, polars and duckdb.

Arrays are flat lists, frame by frame, to be reshaped to [num_frames, num_joints, 3]: fixed-size lists decode at half
the speed (docs/store.md), and not every reader knows them. Files are `data/SPLIT-00000-of-0000N.parquet` of at most
256 MB, in small row groups, so that one sequence can be had without its neighbours.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core.files import naming
from motionkit.errors import UsageError
from motionkit.export.dataset_card import Tally, card
from motionkit.export.selection import Outcome, Selection
from motionkit.formats import parquet_schema
from motionkit.motion import Motion

DATA_FOLDER = "data"
CARD = "README.md"
SHARD_BYTES = 256 * 2**20
ROW_GROUP_BYTES = 8 * 2**20
# A list's offsets are 32 bits wide.
MAX_VALUES = 2**31 - 1
# "validation" is what the Hub's viewer and `datasets` call the split that HumanML3D calls val.
SPLIT_NAMES = {"": "unassigned", "val": "validation"}


def export_parquet(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write `data/*.parquet` by split and the card; raises `UsageError` for a split that cannot be a file's name."""
    for split in set(selection.table["split"].to_pylist()):
        if not _split_name(split).isidentifier():
            raise UsageError(f"the split {split!r} cannot be a file's name: leave its sequences out with --where")
    return _write(selection, folder)


def _write(selection: Selection, folder: Path) -> Iterator[Outcome]:
    data = folder / DATA_FOLDER
    data.mkdir()
    shards: dict[str, _Shards] = {}
    tally = Tally()
    for motion in selection.motions():
        split = _split_name(motion.split)
        if motion.num_frames * motion.skeleton.num_joints * 4 > MAX_VALUES:
            yield Outcome(motion.sequence_id, "too-long", f"{motion.num_frames} frames are more than a row can hold")
            continue
        shards.setdefault(split, _Shards(data, split)).add(motion)
        tally.add(motion, split)
        yield Outcome(motion.sequence_id)
    num_files = {split: each.finish() for split, each in shards.items()}
    if num_files:
        text = card(tally, num_files, parquet_schema.SCHEMA, parquet_schema.MEANING, data)
        (folder / CARD).write_text(text, encoding="utf-8")


def _split_name(split: str) -> str:
    return SPLIT_NAMES.get(split, split)


class _Shards:
    """Writes the files of one split; owns the open file and the rows that wait for their row group."""

    def __init__(self, folder: Path, split: str) -> None:
        self._folder = folder
        self._split = split
        self._paths: list[Path] = []
        self._file: pq.ParquetWriter | None = None
        self._file_bytes = 0
        self._rows: list[dict[str, Any]] = []
        self._row_bytes = 0

    def add(self, motion: Motion) -> None:
        """Take in one sequence; a file that it would make larger than a shard is closed first."""
        row = parquet_schema.row_of(motion)
        num_bytes = sum(row[name].nbytes for name in parquet_schema.MOTION_COLUMNS if row[name] is not None)
        if self._file_bytes and self._file_bytes + num_bytes > SHARD_BYTES:
            self._close()
        self._rows.append(row)
        self._row_bytes += num_bytes
        self._file_bytes += num_bytes
        if self._row_bytes >= ROW_GROUP_BYTES:
            self._flush()

    def finish(self) -> int:
        """Close the last file and give all files their names; returns their number."""
        self._close()
        count = len(self._paths)
        for number, path in enumerate(self._paths):
            path.rename(self._folder / f"{self._split}-{number:05d}-of-{count:05d}.parquet")
        return count

    def _flush(self) -> None:
        if not self._rows:
            return
        if self._file is None:
            self._paths.append(self._folder / f"{self._split}-{len(self._paths):05d}.parquet")
            self._file = pq.ParquetWriter(self._paths[-1], parquet_schema.SCHEMA, **_writer_options())
        columns = [pa.array([row[field.name] for row in self._rows], field.type) for field in parquet_schema.SCHEMA]
        with naming(self._paths[-1]):
            self._file.write_table(pa.table(columns, schema=parquet_schema.SCHEMA))
        self._rows, self._row_bytes = [], 0

    def _close(self) -> None:
        self._flush()
        if self._file is not None:
            with naming(self._paths[-1]):
                self._file.close()
        self._file, self._file_bytes = None, 0


def _writer_options() -> dict[str, Any]:
    return {
        "compression": "zstd",
        "compression_level": 3,
        "use_dictionary": [
            *(field.name for field in parquet_schema.SCHEMA if pa.types.is_string(field.type)),
            *("joint_names.list.element", "parents.list.element", "offsets.list.element"),
            *("left_right_pairs.list.element", "feet.list.element"),
        ],
        "use_byte_stream_split": [f"{name}.list.element" for name in parquet_schema.MOTION_COLUMNS],
        "write_page_index": True,
    }
