"""Motions as rows of Parquet files, as written by `motionkit export --format parquet`.

A row is a self-contained sequence; arrays are flat lists, frame by frame. `sequence_id`, `joint_positions`,
`num_joints` and a framerate (`fps_numerator` and `fps_denominator`, or `fps`) are required, all other columns are
optional. A folder has this form if its files, or those in its folder `data`, have the required columns.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import astuple
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from motionkit.core.checksums import read_json
from motionkit.core.errors import DamagedFileError, FormatError
from motionkit.core.files import sha256_of
from motionkit.core.framerate import format_fps, parse_fps
from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import Feet, Skeleton
from motionkit.core.timegrid import TimeGrid
from motionkit.io import source_file
from motionkit.io.body_frame import in_metres
from motionkit.io.npy import checked_numbers, checked_rotations
from motionkit.io.npz import checked_layout_map, unnamed_skeleton
from motionkit.io.registry import Format, ReadOptions, ScanResult, SourceItem

DATA_FOLDER = "data"
CARD = "README.md"
REQUIRED = frozenset(("sequence_id", "joint_positions", "num_joints"))
# Columns that a scan reads.
STATED = ("sequence_id", "source", "subset", "licence")
# A row group is decoded as a whole.
MAX_ROW_GROUP_BYTES = 2 << 30
CHECKSUMS = "checksums.json"
HINT = "export again, or restore the file from a copy"
FAULTS = (pa.ArrowException, OSError, ValueError, TypeError, KeyError, IndexError, OverflowError, ZeroDivisionError)


def claims(folder: Path) -> bool:
    """Whether a folder's Parquet files, or those in its folder `data`, are rows of motions."""
    first = next(iter(_files(folder)), None)
    try:
        return first is not None and set(pq.read_schema(first).names) >= REQUIRED
    except FAULTS:
        return False


def find(folder: Path, root: Path) -> ScanResult:
    """All rows of all files; ids are the rows' own, below the source's name."""
    items: list[SourceItem] = []
    problems: list[FormatError] = []
    for path in _files(folder):
        try:
            _require_intact(path)
            names = set(pq.read_schema(path).names)
            rows = pq.read_table(path, columns=[name for name in STATED if name in names]).to_pylist()
        except FormatError as error:
            problems.append(error)
            continue
        except FAULTS as error:
            problems.append(_broken(path, error))
            continue
        for number, row in enumerate(rows):
            if row["sequence_id"] in (None, ""):
                problems.append(FormatError(f"row {number}: no sequence_id", path=path, reason="missing-key"))
            else:
                items.append(_item(path, root, number, row))
    return ScanResult(tuple(items), tuple(problems))


def _item(path: Path, root: Path, number: int, row: Mapping[str, Any]) -> SourceItem:
    stated = row.get("source") or ""
    return SourceItem(
        format="parquet",
        path=path,
        root=root,
        sequence_id=f"{root.name}/{row['sequence_id']}",
        key=str(number),
        source=stated or root.name,
        subset=row.get("subset") or "",
        licence=row.get("licence") or "",
    )


def read_parquet(item: SourceItem, options: ReadOptions) -> Motion:
    """Read one row as a motion; raises `FormatError` (`truncated`, `channel-count`, `no-framerate`, `nan` …)."""
    try:
        row = _read_row(item.path, int(item.key))
        return in_metres(_motion(row, options, item.path), options.unit_metres)
    except FormatError:
        raise
    except FAULTS as error:
        raise _broken(item.path, error, item.key) from None


def _require_intact(path: Path) -> None:
    # Without recorded checksums there is nothing to compare with.
    record = path.parent.parent / CHECKSUMS
    try:
        intact = not record.is_file() or sha256_of(path) == read_json(record, HINT).get(path.name)
    except DamagedFileError as error:
        raise FormatError(f"its checksum cannot be read ({error})", path=path, reason="damaged") from None
    if not intact:
        raise FormatError(f"not what {CHECKSUMS} says: {HINT}", path=path, reason="damaged")


def _files(folder: Path) -> list[Path]:
    here = sorted(folder.glob("*.parquet"))
    return here or sorted((folder / DATA_FOLDER).glob("*.parquet"))


def _read_row(path: Path, row: int) -> dict[str, Any]:
    """One row; large lists of numbers stay arrays."""
    modified = path.stat().st_mtime_ns
    groups = _row_groups(path, modified)
    group = int(np.searchsorted(groups, row, side="right")) - 1
    table = _read_group(path, group, modified).slice(row - int(groups[group]), 1)
    cells = {name: table[name].combine_chunks() for name in table.column_names}
    return {
        name: cell.values.slice(*_bounds(cell)).to_numpy(zero_copy_only=False) if _is_numbers(cell) else cell[0].as_py()
        for name, cell in cells.items()
    }


def _is_numbers(cell: pa.Array) -> bool:
    lists = pa.types.is_list(cell.type) or pa.types.is_large_list(cell.type)
    return bool(lists and cell.null_count == 0 and pa.types.is_floating(cell.type.value_type))


def _bounds(cell: pa.Array) -> tuple[int, int]:
    start, stop = cell.offsets.to_pylist()
    return start, stop - start


@lru_cache(maxsize=8)
def _row_groups(path: Path, _modified: int) -> np.ndarray:
    metadata = pq.ParquetFile(path).metadata
    return np.cumsum([0, *(metadata.row_group(group).num_rows for group in range(metadata.num_row_groups))])


# Rows come in order, and many share a row group.
@lru_cache(maxsize=1)
def _read_group(path: Path, group: int, _modified: int) -> pa.Table:
    file = pq.ParquetFile(path, page_checksum_verification=True)
    size = file.metadata.row_group(group).total_byte_size
    if size > MAX_ROW_GROUP_BYTES:
        raise FormatError(
            f"a row group of {size} bytes, expected at most {MAX_ROW_GROUP_BYTES}", path=path, reason="too-large"
        )
    return file.read_row_group(group)


def _motion(row: Mapping[str, Any], options: ReadOptions, path: Path) -> Motion:
    num_joints = int(row["num_joints"])
    if num_joints < 1:
        raise FormatError(f"num_joints is {num_joints}, expected at least 1", path=path, reason="channel-count")
    positions = _frames(row, "joint_positions", (num_joints, 3), path)
    try:
        stated = _stated_fps(row, path)
    except FormatError:
        if options.fps is None:
            raise
        stated = None
    fps = options.fps or stated
    if fps is None:
        message = "neither fps nor fps_numerator and fps_denominator; add a column, or use --fps"
        raise FormatError(message, path=path, reason="no-framerate")
    rotations, root = (
        _frames(row, name, shape, path) if row.get(name) is not None else None
        for name, shape in (("local_rotations", (num_joints, 4)), ("root_translation", (3,)))
    )
    if rotations is not None:
        checked_rotations(rotations, path, "local_rotations")
    said_fps = row.get("stated_fps")
    said = {name: row.get(name) or "" for name in ("source", "subset", "licence", "subject")}
    return Motion(
        joint_positions=positions,
        skeleton=_skeleton(row, num_joints, path),
        timegrid=TimeGrid(fps, len(positions), float(row.get("start_seconds") or 0.0)),
        captions=tuple(_caption(caption) for caption in row.get("captions") or ()),
        local_rotations=rotations,
        root_translation=root,
        action=row.get("action") or "",
        style=row.get("style") or "",
        split=row.get("split") or "",
        sequence_id=row["sequence_id"],
        provenance=Provenance(
            **said,
            source_path=path.name,
            source_sha256=_sha256(fps, positions, rotations, root),
            source_format="parquet",
            stated_fps=f"fps: {format_fps(stated)}" if said_fps is None and stated is not None else said_fps or "",
            operations=(*(row.get("operations") or ()), *source_file.replaced_fps(fps, stated)),
        ),
    )


def _frames(row: Mapping[str, Any], name: str, shape: tuple[int, ...], path: Path) -> Float32[np.ndarray, "frames ..."]:
    values = np.asarray(row[name], np.float32)
    if not values.size or values.size % int(np.prod(shape)):
        message = f"{name}: {values.size} numbers, expected frames of {' × '.join(map(str, shape))}"
        raise FormatError(message, path=path, reason="channel-count")
    return checked_numbers(values.reshape(-1, *shape), path, name)


def _caption(value: str | Mapping[str, Any]) -> Caption:
    # Most tables have a list of plain sentences.
    if isinstance(value, str):
        return Caption(value)
    return Caption(
        value["text"], value.get("start_seconds") or 0.0, value.get("end_seconds"), value.get("tokens") or ""
    )


def _stated_fps(row: Mapping[str, Any], path: Path) -> Fraction | None:
    numerator, denominator = row.get("fps_numerator"), row.get("fps_denominator")
    try:
        if numerator is not None and denominator is not None:
            return parse_fps(Fraction(numerator, denominator))
        return None if row.get("fps") is None else parse_fps(row["fps"])
    except (ValueError, TypeError, ZeroDivisionError) as error:
        raise FormatError(f"fps: {error}", path=path, reason="frame-time") from None


def _skeleton(row: Mapping[str, Any], num_joints: int, path: Path) -> Skeleton:
    names = row.get("joint_names")
    if names is None:
        return unnamed_skeleton(num_joints, path)
    tips = zip(row.get("end_site_joints") or (), np.reshape(_array(row, "end_site_offsets"), (-1, 3)), strict=True)
    pairs = np.reshape(_array(row, "left_right_pairs"), (-1, 2)).astype(int).tolist()
    feet = row.get("feet") or ()
    return Skeleton(
        row.get("skeleton") or "",
        tuple(names),
        tuple(row["parents"]),
        np.asarray(row["offsets"], np.float32).reshape(num_joints, 3),
        left_right_pairs=tuple((left, right) for left, right in pairs),
        feet=Feet(*feet) if len(feet) else None,
        end_sites=tuple((joint, (float(x), float(y), float(z))) for joint, (x, y, z) in tips),
        layout_map=checked_layout_map(row.get("layout_map") or "", path),
    )


def _array(row: Mapping[str, Any], name: str) -> np.ndarray:
    value = row.get(name)
    return np.asarray([] if value is None else value)


def _sha256(fps: Fraction, *arrays: Float32[np.ndarray, "frames ..."] | None) -> str:
    """Hash of the row's contents, not of its file, which holds thousands of rows."""
    digest = hashlib.sha256(str(fps).encode())
    for array in arrays:
        digest.update(b"-" if array is None else np.ascontiguousarray(array, "<f4").tobytes())
    return digest.hexdigest()


def _broken(path: Path, error: Exception, key: str = "") -> FormatError:
    where = f"row {key}: " if key else ""
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return FormatError(f"{where}not rows of motions ({text[:160]})", path=path, reason="truncated")


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
        ("left_right_pairs", _list(pa.int32())),
        ("feet", _list(pa.int32())),
        ("end_site_joints", _list(pa.int32())),
        ("end_site_offsets", _list(pa.float64())),
        ("layout_map", pa.string()),
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
    "left_right_pairs": "[pairs, 2], joints that are mirror images",
    "feet": "left ankle, left toe, right ankle, right toe; empty where they are not known",
    "end_site_offsets": "metres; tips of the joints in end_site_joints; [tips, 3]",
    "layout_map": "the user's own table of how the skeleton becomes the 22 joints of SMPL, as JSON; empty without one",
}


def row_of(motion: Motion) -> dict[str, Any]:
    """A motion as a row of `SCHEMA`."""
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
        "captions": list(map(vars, motion.captions)),
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
        "left_right_pairs": [joint for pair in skeleton.left_right_pairs for joint in pair],
        "feet": [] if skeleton.feet is None else list(astuple(skeleton.feet)),
        "end_site_joints": [joint for joint, _ in skeleton.end_sites],
        "end_site_offsets": [value for _, offset in skeleton.end_sites for value in offset],
        "layout_map": skeleton.layout_map,
    }


FORMAT = Format(
    name="parquet",
    read=read_parquet,
    claims=claims,
    find=find,
)
