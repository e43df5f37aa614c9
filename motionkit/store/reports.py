"""What `motionkit info` says of a store, its quality, one motion and its rig."""

from collections import Counter
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map
from motionkit.features.quality import measure
from motionkit.io.body_frame import logged_unit, logged_up, standing_metres
from motionkit.store.cache import cache_bytes
from motionkit.store.reader import Store
from motionkit.store.schema import Row

DURATION_EDGES = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0)


def summarise(store: Store) -> Row:
    """Count what a store holds; reads the table of sequences, no frames.

    `sources` are rows of the same counts for each source, its mappings count sequences. `disk_bytes` are those of the
    files that the manifest names, `cache_bytes` come on top.
    """
    sequences, manifest = store.sequences_table, store.manifest
    # Arrow's own scalars: converting Python's would import pandas.
    names = sorted(sequences["source"].unique(), key=lambda scalar: scalar.as_py())
    sources = [_summarise_source(name.as_py(), sequences.filter(pc.equal(sequences["source"], name))) for name in names]
    return {
        "path": str(store.path),
        "fingerprint": store.fingerprint,
        "tool": manifest.tool,
        "num_sequences": manifest.num_sequences,
        "hours": _hours(sequences),
        "num_frames": store.num_frames,
        "num_skeletons": len(store.skeletons),
        "num_parts": len(manifest.parts),
        "num_removed": manifest.num_removed,
        "disk_bytes": manifest.num_bytes,
        "cache_bytes": cache_bytes(store.path, store.fingerprint),
        "licences": sorted({name or "not stated" for source in sources for name in source["licences"]}),
        "sources": sources,
    }


def _summarise_source(source: str, rows: pa.Table) -> Row:
    num_captions = pc.list_value_length(rows["captions"])
    fps = Counter(map(Fraction, rows["fps_numerator"].to_pylist(), rows["fps_denominator"].to_pylist()))
    return {
        "source": source,
        "num_sequences": rows.num_rows,
        "hours": _hours(rows),
        "num_frames": _total(rows["num_frames"]),
        "framerates": {str(each): fps[each] for each in sorted(fps)},
        "splits": _counts(rows["split"]),
        "formats": _counts(rows["source_format"]),
        "licences": _counts(rows["licence"]),
        "num_actions": len(set(rows["action"].unique().to_pylist()) - {""}),
        "num_captions": _total(num_captions),
        "num_captioned": _total(pc.sign(num_captions)),
        "num_skeletons": len(rows["skeleton"].unique()),
        "joints": _counts(rows["num_joints"]),
        "quality_flags": dict(Counter(pc.list_flatten(rows["quality_flags"]).to_pylist()).most_common()),
        "durations": _durations(rows["duration_seconds"].to_pylist()),
    }


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


# Each flag's column, its unit, how bad a value is (SQL), and the column that says where it is worst.
FIGURES = {
    "teleport": ("num_teleports", "jumps", "num_teleports", "first_teleport_seconds"),
    "joint_speed": ("max_joint_speed_metres_per_second", "m/s", "max_joint_speed_metres_per_second", "NULL"),
    "jitter": ("jitter_metres_per_second_cubed", "m/s³", "jitter_metres_per_second_cubed", "NULL"),
    "frozen": ("frozen_seconds", "s", "frozen_seconds", "frozen_start_seconds"),
    "foot_skate": ("foot_skate_metres_per_second", "m/s", "foot_skate_metres_per_second", "NULL"),
    "floor_height": ("floor_height_metres", "m", "abs(floor_height_metres)", "NULL"),
    "upsampled": ("effective_fps", "fps", "-effective_fps / fps", "NULL"),
    "bone_length": ("bone_length_drift", "of its length", "bone_length_drift", "NULL"),
}
SHOWN_WORST = 5


def report_quality(store: Store, where: str | None = None) -> Row:
    """What looks odd in the sequences for which `where` (SQL) holds; raises `UsageError` for bad SQL.

    `sources` counts the sequences of each source by flag, and those without any (`clean`); `worst` lists, by flag, the
    sequences with the worst figures and where in them.
    """
    store.select(where)  # an error names the condition
    chosen = f"(FROM sequences WHERE ({where or 'true'}))"
    sources: dict[str, Row] = {}
    for row in store.query(
        f"SELECT source, flag, count(*) AS n, sum(duration_seconds) / 3600 AS hours FROM (SELECT *, unnest(list_concat("
        f"if(len(quality_flags) = 0, [''], quality_flags), [NULL])) AS flag FROM {chosen}) "
        "GROUP BY ALL ORDER BY source, n DESC, flag"
    ).to_pylist():
        nothing = {"num_sequences": 0, "hours": 0.0}
        source = sources.setdefault(row["source"], {"source": row["source"], **nothing, "clean": nothing, "flags": {}})
        counts = {"num_sequences": row["n"], "hours": row["hours"]}
        if row["flag"] is None:
            source |= counts
        elif row["flag"] == "":
            source["clean"] = counts
        else:
            source["flags"][row["flag"]] = counts
    worst = []
    for flag, (column, unit, badness, place) in FIGURES.items():
        offenders = store.query(
            f"SELECT sequence_id, CAST({column} AS DOUBLE) AS value, {place} AS seconds, "
            f"CAST(round({place} * fps) AS INT) AS frame FROM {chosen} WHERE list_contains(quality_flags, '{flag}') "
            f"ORDER BY {badness} DESC, sequence_index LIMIT {SHOWN_WORST}"
        ).to_pylist()
        if offenders:
            worst.append({"flag": flag, "column": column, "unit": unit, "offenders": offenders})
    num_sequences = sum(source["num_sequences"] for source in sources.values())
    return {
        **{"store": str(store.path), "where": where, "num_sequences": num_sequences},
        **{"sources": list(sources.values()), "worst": worst},
    }


def describe_motion(motion: Motion, *, has_framerate: bool = True) -> Row:
    """What a motion in memory is, the file that it comes from, as its reader returned it, and its mapping to the 22.

    `fps` is exact (30000/1001) and `stated_fps` what the file says; `fps` and `duration_seconds` are None if nothing
    says a framerate. `height_metres` is the length from the ankles along the bones to the base of the skull, None for
    joints that are not mapped to the 22. `unit_metres` and `up` are the file's; the motion is in metres, y up. `family`
    is the map that fits its skeleton, empty where none does and joints are `missing`.
    """
    source = motion.provenance
    unit_metres, unit = logged_unit(source.operations)
    family = ""
    missing: tuple[str, ...] = ()
    height: float | None = None
    try:
        family = joint_map(motion.skeleton, SMPL22.name).family
        height = standing_metres(motion.skeleton, motion.joint_positions)
    except SkeletonMapError as error:
        missing = error.missing
    return {
        "sequence_id": motion.sequence_id,
        "format": source.source_format,
        "fps": str(motion.fps) if has_framerate else None,
        "stated_fps": source.stated_fps,
        "num_frames": motion.num_frames,
        "duration_seconds": motion.duration_seconds if has_framerate else None,
        "height_metres": height,
        "unit_metres": unit_metres,
        "unit": unit,
        "up": logged_up(source.operations),
        "skeleton": motion.skeleton.name,
        "num_joints": motion.skeleton.num_joints,
        "has_rotations": motion.local_rotations is not None,
        "num_captions": len(motion.captions),
        "quality_flags": list(measure(motion).flags) if has_framerate else [],
        "operations": list(source.operations),
        "family": family,
        "missing": missing,
    }
