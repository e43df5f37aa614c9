"""A Parquet data set with a card: one self-contained row per sequence, for `datasets`, pandas, polars and duckdb.

Arrays are flat lists, frame by frame, to be reshaped to [num_frames, num_joints, 3]: fixed-size lists decode at half
the speed (docs/store.md), and not every reader supports them. Files are `data/SPLIT-00000-of-0000N.parquet` of at most
256 MB, in small row groups, so that single sequences can be read.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core.checksums import write_json
from motionkit.core.errors import UsageError
from motionkit.core.files import naming, sha256_of
from motionkit.core.framerate import format_fps
from motionkit.core.motion import Motion
from motionkit.edit.export.files import Outcome, Selection, render
from motionkit.io import parquet

# The Hub's names of motion captures' usual licences (huggingface.co/docs/hub/repositories-licenses).
HUB_LICENCES = (
    *("mit", "apache-2.0", "bsd-3-clause", "cc0-1.0", "odc-by", "pddl", "unlicense"),
    *(f"cc-by{kind}-{version}" for kind in ("", "-sa", "-nc", "-nd", "-nc-sa", "-nc-nd") for version in ("3.0", "4.0")),
)
SIZE_CATEGORIES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
NO_LICENCE = "not stated"


class Tally:
    """Statistics of a data set's sequences; owns the counts."""

    def __init__(self) -> None:
        self.num_sequences = 0
        self.num_captions = 0
        self.hours = 0.0
        self.bytes_by_split: Counter[str] = Counter()
        self.sequences_by_split: Counter[str] = Counter()
        self.hours_by_split: defaultdict[str, float] = defaultdict(float)
        self.sequences_by_fps: Counter[Fraction] = Counter()
        self.hours_by_fps: defaultdict[Fraction, float] = defaultdict(float)
        self.sequences_by_licence: Counter[tuple[str, str]] = Counter()
        self.sequences_by_skeleton: Counter[tuple[str, int]] = Counter()

    def add(self, motion: Motion, split: str) -> None:
        """Count one sequence."""
        hours = motion.duration_seconds / 3600
        self.num_sequences += 1
        self.num_captions += len(motion.captions)
        self.hours += hours
        arrays = (motion.joint_positions, motion.local_rotations, motion.root_translation)
        self.bytes_by_split[split] += sum(array.nbytes for array in arrays if array is not None)
        self.sequences_by_split[split] += 1
        self.hours_by_split[split] += hours
        self.sequences_by_fps[motion.fps] += 1
        self.hours_by_fps[motion.fps] += hours
        provenance = motion.provenance
        self.sequences_by_licence[provenance.source, provenance.licence or NO_LICENCE] += 1
        self.sequences_by_skeleton[motion.skeleton.name, motion.skeleton.num_joints] += 1


def card(tally: Tally, num_files: Mapping[str, int], schema: pa.Schema, meaning: Mapping[str, str], data: Path) -> str:
    """The text of README.md for the files in `data`; `meaning` describes columns whose names are not clear."""
    return render(
        "dataset_card.md.j2",
        tally=tally,
        num_files=num_files,
        **card_head({licence for _, licence in tally.sequences_by_licence}, tally.num_sequences),
        features=[_feature(field.name, field.type) for field in schema],
        columns=[(field.name, _type_name(field.type), meaning.get(field.name, "")) for field in schema],
        download_size=sum(path.stat().st_size for path in data.iterdir()),
        fps_names={fps: _fps_name(fps) for fps in tally.sequences_by_fps},
    )


def card_head(licences: Iterable[str], num_sequences: int) -> dict[str, Any]:
    """The licences and size in a card's metadata, in the Hub's terms (templates/card_head.j2)."""
    names = sorted(licences)
    known = [_hub_licence(name) for name in names]
    return {
        "licences": known if names and all(known) else ["other"],
        "licence_name": "; ".join(names),
        "size_category": next((name for limit, name in SIZE_CATEGORIES if num_sequences < limit), "n>1M"),
    }


def _hub_licence(name: str) -> str:
    plain = "-".join(name.lower().replace("creative commons", "cc").replace("_", "-").split())
    return plain if plain in HUB_LICENCES else ""


def _fps_name(fps: Fraction) -> str:
    return format_fps(fps) if fps.denominator == 1 else f"{float(fps):.6g} ({format_fps(fps)})"


def _feature(name: str, kind: pa.DataType) -> dict[str, Any]:
    """A column as `datasets` writes it in YAML."""
    if not pa.types.is_list(kind):
        return {"name": name, "dtype": _type_name(kind)}
    if pa.types.is_struct(kind.value_type):
        return {"name": name, "list": [_feature(field.name, field.type) for field in kind.value_type]}
    return {"name": name, "list": _type_name(kind.value_type)}


def _type_name(kind: pa.DataType) -> str:
    if pa.types.is_list(kind):
        return "list of structs" if pa.types.is_struct(kind.value_type) else f"list of {_type_name(kind.value_type)}"
    return {"float": "float32", "double": "float64"}.get(str(kind), str(kind))


SHARD_BYTES = 256 * 2**20
ROW_GROUP_BYTES = 8 * 2**20
# A list's offsets are 32 bits wide.
MAX_VALUES = 2**31 - 1
# The Hub's viewer and `datasets` call HumanML3D's split val "validation".
SPLIT_NAMES = {"": "unassigned", "val": "validation"}


def export_parquet(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write `data/*.parquet` by split and the card; raises `UsageError` for a split that is not a valid file name."""
    for split in set(selection.table["split"].to_pylist()):
        if not _split_name(split).isidentifier():
            raise UsageError(f"the split {split!r} cannot be a file's name: leave its sequences out with --where")
    return _write(selection, folder)


def _write(selection: Selection, folder: Path) -> Iterator[Outcome]:
    data = folder / parquet.DATA_FOLDER
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
        text = card(tally, num_files, parquet.SCHEMA, parquet.MEANING, data)
        (folder / parquet.CARD).write_text(text, encoding="utf-8")
        write_json(folder / parquet.CHECKSUMS, {path.name: sha256_of(path) for path in sorted(data.iterdir())})


def _split_name(split: str) -> str:
    return SPLIT_NAMES.get(split, split)


class _Shards:
    """Writes the files of one split; owns the open file and the rows buffered for the next row group."""

    def __init__(self, folder: Path, split: str) -> None:
        self._folder = folder
        self._split = split
        self._paths: list[Path] = []
        self._file: pq.ParquetWriter | None = None
        self._file_bytes = 0
        self._rows: list[dict[str, Any]] = []
        self._row_bytes = 0

    def add(self, motion: Motion) -> None:
        """Add one sequence; closes the current file first if the sequence would exceed a shard's size."""
        row = parquet.row_of(motion)
        num_bytes = sum(row[name].nbytes for name in parquet.MOTION_COLUMNS if row[name] is not None)
        if self._file_bytes and self._file_bytes + num_bytes > SHARD_BYTES:
            self._close()
        self._rows.append(row)
        self._row_bytes += num_bytes
        self._file_bytes += num_bytes
        if self._row_bytes >= ROW_GROUP_BYTES:
            self._flush()

    def finish(self) -> int:
        """Close the last file and rename all files; returns their number."""
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
            self._file = pq.ParquetWriter(self._paths[-1], parquet.SCHEMA, **_writer_options())
        columns = [pa.array([row[field.name] for row in self._rows], field.type) for field in parquet.SCHEMA]
        with naming(self._paths[-1]):
            self._file.write_table(pa.table(columns, schema=parquet.SCHEMA))
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
            *(field.name for field in parquet.SCHEMA if pa.types.is_string(field.type)),
            *("joint_names.list.element", "parents.list.element", "offsets.list.element"),
            *("left_right_pairs.list.element", "feet.list.element"),
        ],
        "use_byte_stream_split": [f"{name}.list.element" for name in parquet.MOTION_COLUMNS],
        "write_page_index": True,
        "write_page_checksum": True,
    }
