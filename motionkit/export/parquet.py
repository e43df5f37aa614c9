"""A Parquet data set with a card: one self-contained row per sequence, for `datasets`, pandas, polars and duckdb.

Arrays are flat lists, frame by frame, to be reshaped to [num_frames, num_joints, 3]: fixed-size lists decode at half
the speed (docs/store.md), and not every reader knows them. Files are `data/SPLIT-00000-of-0000N.parquet` of at most
256 MB, in small row groups, so that one sequence can be had without its neighbours.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.errors import UsageError
from motionkit.export.dataset_card import Tally, card
from motionkit.export.selection import Outcome, Selection
from motionkit.motion import Motion

DATA_FOLDER = "data"
CARD = "README.md"
SHARD_BYTES = 256 * 2**20
ROW_GROUP_BYTES = 8 * 2**20
# A list's offsets are 32 bits wide.
MAX_VALUES = 2**31 - 1
# "validation" is what the Hub's viewer and `datasets` call the split that HumanML3D calls val.
SPLIT_NAMES = {"": "unassigned", "val": "validation"}


def _list(kind: Any) -> Any:
    return pa.list_(pa.field("element", kind, nullable=False))


CAPTION = pa.struct(
    [
        pa.field("text", pa.string()),
        pa.field("start_seconds", pa.float64()),
        pa.field("end_seconds", pa.float64()),
        pa.field("tokens", pa.string()),
    ]
)
SCHEMA = pa.schema(
    [
        ("sequence_id", pa.string()),
        ("joint_positions", _list(pa.float32())),
        ("local_rotations", _list(pa.float32())),
        ("root_translation", _list(pa.float32())),
        ("num_frames", pa.int32()),
        ("num_joints", pa.int32()),
        ("fps", pa.float64()),
        ("fps_numerator", pa.int64()),
        ("fps_denominator", pa.int64()),
        ("start_seconds", pa.float64()),
        ("duration_seconds", pa.float64()),
        ("captions", _list(CAPTION)),
        ("action", pa.string()),
        ("style", pa.string()),
        ("split", pa.string()),
        ("subject", pa.string()),
        ("source", pa.string()),
        ("subset", pa.string()),
        ("licence", pa.string()),
        ("stated_fps", pa.string()),
        ("operations", _list(pa.string())),
        ("skeleton", pa.string()),
        ("joint_names", _list(pa.string())),
        ("parents", _list(pa.int32())),
        ("offsets", _list(pa.float32())),
    ]
)
MOTION_COLUMNS = ("joint_positions", "local_rotations", "root_translation")
MEANING = {
    "joint_positions": "metres, y up; reshape to [num_frames, num_joints, 3]",
    "local_rotations": "unit quaternions (w, x, y, z) relative to the parent; [num_frames, num_joints, 4]; null where "
    "the source has none",
    "root_translation": "metres; [num_frames, 3]; null where the source has none",
    "fps": "framerate; exactly fps_numerator / fps_denominator",
    "start_seconds": "time of the first frame; frame k is at start_seconds + k / fps",
    "captions": "text, start_seconds, end_seconds (null: to the end), tokens (word/POS)",
    "stated_fps": "what the source said of its framerate, verbatim",
    "operations": "what was done to the motion since its source file, oldest first",
    "joint_names": "the skeleton's joints, the root first",
    "parents": "index of each joint's parent, −1 for the root",
    "offsets": "metres; rest position relative to the parent; [num_joints, 3]",
}


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
        text = card(tally, num_files, SCHEMA, MEANING, data)
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
        row = _row(motion)
        num_bytes = sum(row[name].nbytes for name in MOTION_COLUMNS if row[name] is not None)
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
            self._file = pq.ParquetWriter(self._paths[-1], SCHEMA, **_writer_options())
        columns = [pa.array([row[field.name] for row in self._rows], field.type) for field in SCHEMA]
        self._file.write_table(pa.table(columns, schema=SCHEMA))
        self._rows, self._row_bytes = [], 0

    def _close(self) -> None:
        self._flush()
        if self._file is not None:
            self._file.close()
        self._file, self._file_bytes = None, 0


def _row(motion: Motion) -> dict[str, Any]:
    skeleton, provenance = motion.skeleton, motion.provenance
    return {
        "sequence_id": motion.sequence_id,
        "joint_positions": motion.joint_positions.ravel(),
        "local_rotations": None if motion.local_rotations is None else motion.local_rotations.ravel(),
        "root_translation": None if motion.root_translation is None else motion.root_translation.ravel(),
        "num_frames": motion.num_frames,
        "num_joints": skeleton.num_joints,
        "fps": float(motion.fps),
        "fps_numerator": motion.fps.numerator,
        "fps_denominator": motion.fps.denominator,
        "start_seconds": motion.timegrid.start_seconds,
        "duration_seconds": motion.duration_seconds,
        "captions": [
            {name: getattr(caption, name) for name in ("text", "start_seconds", "end_seconds", "tokens")}
            for caption in motion.captions
        ],
        "action": motion.action,
        "style": motion.style,
        "split": motion.split,
        "subject": provenance.subject,
        "source": provenance.source,
        "subset": provenance.subset,
        "licence": provenance.licence,
        "stated_fps": provenance.stated_fps,
        "operations": list(provenance.operations),
        "skeleton": skeleton.name,
        "joint_names": list(skeleton.joint_names),
        "parents": list(skeleton.parents),
        "offsets": np.asarray(skeleton.offsets, np.float32).ravel(),
    }


def _writer_options() -> dict[str, Any]:
    return {
        "compression": "zstd",
        "compression_level": 3,
        "use_dictionary": [
            *(field.name for field in SCHEMA if pa.types.is_string(field.type)),
            *("joint_names.list.element", "parents.list.element", "offsets.list.element"),
        ],
        "use_byte_stream_split": [f"{name}.list.element" for name in MOTION_COLUMNS],
        "write_page_index": True,
    }
