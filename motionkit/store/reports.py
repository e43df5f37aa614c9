"""What `motionkit info` says: of a store, its quality and its rigs; of one motion and its rig."""

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
from motionkit.core.files import require_regular
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map
from motionkit.features.quality import measure
from motionkit.io.body_frame import logged_unit, logged_up, standing_metres
from motionkit.store.cache import cache_bytes
from motionkit.store.reader import Store
from motionkit.store.schema import FRAME_COLUMNS

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
    sequences, manifest = store.sequences_table, store.manifest
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
        framerates={str(each): fps[each] for each in sorted(fps)},
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
            require_regular(store.path / name)
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


@dataclass(frozen=True)
class FlagCount:
    """Number of sequences with a flag, and their total duration."""

    num_sequences: int
    hours: float


@dataclass(frozen=True)
class SourceQuality:
    """One source's sequences; `flags` most frequent first, `clean` those without any."""

    source: str
    num_sequences: int
    hours: float
    clean: FlagCount
    flags: dict[str, FlagCount]


@dataclass(frozen=True)
class Offender:
    """A flagged sequence: the figure that the flag is about, and where in the sequence (None: all of it)."""

    sequence_id: str
    value: float
    seconds: float | None
    frame: int | None


@dataclass(frozen=True)
class WorstOf:
    """The worst sequences with a flag; `column` and `unit` describe their values."""

    flag: str
    column: str
    unit: str
    offenders: tuple[Offender, ...]


@dataclass(frozen=True)
class Upsampled:
    """A sequence whose frames show a lower framerate than stated."""

    sequence_id: str
    stated_fps: str
    fps: float
    effective_fps: float


@dataclass(frozen=True)
class QualityReport:
    """The report of `motionkit info --quality`."""

    store: str
    where: str | None
    num_sequences: int
    sources: tuple[SourceQuality, ...]
    worst: tuple[WorstOf, ...]
    upsampled: tuple[Upsampled, ...]


# Each flag's column, its unit, how bad a value is (SQL), and the column that says where it is worst.
FIGURES = {
    "teleport": ("num_teleports", "jumps", "num_teleports", "first_teleport_seconds"),
    "joint_speed": ("max_joint_speed_metres_per_second", "m/s", "max_joint_speed_metres_per_second", "NULL"),
    "jitter": ("jitter_metres_per_second_cubed", "m/s³", "jitter_metres_per_second_cubed", "NULL"),
    "frozen": ("frozen_seconds", "s", "frozen_seconds", "frozen_start_seconds"),
    "foot_skate": ("foot_skate_metres_per_second", "m/s", "foot_skate_metres_per_second", "NULL"),
    "floor_height": ("floor_height_metres", "m", "abs(floor_height_metres)", "NULL"),
    "bone_length": ("bone_length_drift", "of its length", "bone_length_drift", "NULL"),
}
SHOWN_WORST = 5


def report_quality(store: Store, where: str | None = None) -> QualityReport:
    """Add up the quality columns of the sequences for which `where` (SQL) holds; raises `UsageError` for bad SQL."""
    store.select(where)  # an error names the condition
    chosen = f"(FROM sequences WHERE ({where or 'true'}))"
    counted = store.query(
        f"SELECT source, flag, count(*) AS n, sum(duration_seconds) / 3600 AS hours FROM (SELECT *, unnest(list_concat("
        f"if(len(quality_flags) = 0, [''], quality_flags), [NULL])) AS flag FROM {chosen}) "
        "GROUP BY ALL ORDER BY source, n DESC, flag"
    ).to_pylist()
    sources = []
    for source in dict.fromkeys(row["source"] for row in counted):
        counts = {row["flag"]: FlagCount(row["n"], row["hours"]) for row in counted if row["source"] == source}
        every, clean = counts.pop(None), counts.pop("", FlagCount(0, 0.0))
        sources.append(SourceQuality(source, every.num_sequences, every.hours, clean, counts))
    worst = []
    for flag, (column, unit, badness, place) in FIGURES.items():
        rows = store.query(
            f"SELECT sequence_id, CAST({column} AS DOUBLE) AS value, {place} AS seconds, "
            f"CAST(round({place} * fps) AS INT) AS frame FROM {chosen} WHERE list_contains(quality_flags, '{flag}') "
            f"ORDER BY {badness} DESC, sequence_index LIMIT {SHOWN_WORST}"
        ).to_pylist()
        if rows:
            worst.append(WorstOf(flag, column, unit, tuple(Offender(**row) for row in rows)))
    upsampled = store.query(
        f"SELECT sequence_id, stated_fps, fps, effective_fps FROM {chosen} "
        "WHERE list_contains(quality_flags, 'upsampled') ORDER BY sequence_index"
    ).to_pylist()
    return QualityReport(
        store=str(store.path),
        where=where,
        num_sequences=sum(source.num_sequences for source in sources),
        sources=tuple(sources),
        worst=tuple(worst),
        upsampled=tuple(Upsampled(**row) for row in upsampled),
    )


@dataclass(frozen=True)
class RigJoint:
    """A joint: how many are above it, its offset from the one above in metres, the layout's joints it is part of."""

    name: str
    parent: str
    depth: int
    offset: tuple[float, float, float]
    taken_for: tuple[str, ...]


@dataclass(frozen=True)
class RigTree:
    """A rig's joints; `family` is the map that fits it, empty where none does and joints are `missing`."""

    family: str
    missing: tuple[str, ...]
    joints: tuple[RigJoint, ...]


def rig_of(skeleton: Skeleton) -> RigTree:
    """The mapping of a skeleton to the 22 joints."""
    family = ""
    missing: tuple[str, ...] = ()
    used: dict[str, list[str]] = {name: [] for name in skeleton.joint_names}
    try:
        found = joint_map(skeleton, SMPL22.name)
        family = found.family
        for row, joint in zip(found.weights, SMPL22.joint_names, strict=True):
            for column in row.nonzero()[0].tolist():
                used[skeleton.joint_names[column]].append(joint)
    except SkeletonMapError as error:
        missing = error.missing
    depths: list[int] = []
    joints = []
    for joint_name, parent, offset in zip(
        skeleton.joint_names, skeleton.parents, skeleton.offsets.tolist(), strict=True
    ):
        depths.append(depths[parent] + 1 if parent >= 0 else 0)
        above = skeleton.joint_names[parent] if parent >= 0 else ""
        joints.append(RigJoint(joint_name, above, depths[-1], tuple(offset), tuple(used[joint_name])))
    return RigTree(family, missing, tuple(joints))


@dataclass(frozen=True)
class MotionSummary:
    """A motion in memory and the file that it comes from.

    `fps` is exact (30000/1001) and `stated_fps` what the file says; `fps` and `duration_seconds` are None if nothing
    says a framerate. `height_metres` is the length from the ankles along the bones to the base of the skull, None for
    joints that are not mapped to the 22. `unit_metres` and `up` are the file's; the motion is in metres, y up.
    """

    sequence_id: str
    format: str
    fps: str | None
    stated_fps: str
    num_frames: int
    duration_seconds: float | None
    height_metres: float | None
    unit_metres: float
    unit: str
    up: str
    skeleton: str
    num_joints: int
    has_rotations: bool
    num_captions: int
    quality_flags: tuple[str, ...]
    operations: tuple[str, ...]


def summarise_motion(motion: Motion, *, has_framerate: bool = True) -> MotionSummary:
    """Describe a motion as its reader returned it."""
    source = motion.provenance
    unit_metres, unit = logged_unit(source.operations)
    try:
        height = standing_metres(motion.skeleton, motion.joint_positions)
    except SkeletonMapError:
        height = None
    return MotionSummary(
        sequence_id=motion.sequence_id,
        format=source.source_format,
        fps=str(motion.fps) if has_framerate else None,
        stated_fps=source.stated_fps,
        num_frames=motion.num_frames,
        duration_seconds=motion.duration_seconds if has_framerate else None,
        height_metres=height,
        unit_metres=unit_metres,
        unit=unit,
        up=logged_up(source.operations),
        skeleton=motion.skeleton.name,
        num_joints=motion.skeleton.num_joints,
        has_rotations=motion.local_rotations is not None,
        num_captions=len(motion.captions),
        quality_flags=measure(motion).flags if has_framerate else (),
        operations=source.operations,
    )
