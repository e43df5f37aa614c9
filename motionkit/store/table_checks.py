"""Consistency checks of the tables' rows, which checksums don't cover.

They run when a store is opened, so that later code never gets a negative framerate or a row outside its part.
`motionkit validate` prints all faults.
"""

from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from motionkit.core.errors import MotionkitError, StoreError
from motionkit.core.shapes import Bool, Float64, Int64
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.families import parse_layout_map
from motionkit.store import codec
from motionkit.store.codec import numbers_of
from motionkit.store.manifest import Manifest
from motionkit.store.schema import (
    MANIFEST_FILE,
    SEGMENT_FRAMES,
    SEQUENCES_FILE,
    SKELETONS_FILE,
    part_name,
    part_number,
)

# Figures of a sequence that follow from others were computed in float64.
_RELATIVE_ERROR = 1e-12
# People give captions' ends in tenths of seconds, and releases of a data set differ by some frames.
CAPTION_TOLERANCE_SECONDS = 0.25

CHECKED_COLUMNS = (
    "sequence_index",
    "sequence_id",
    "fps_numerator",
    "fps_denominator",
    "fps",
    "num_frames",
    "duration_seconds",
    "start_seconds",
    "seconds_between_frames",
    "skeleton",
    "num_joints",
    "part",
    "first_row",
    "num_segments",
)


def require_sound(store: Path, manifest: Manifest, sequences: pa.Table, skeletons: pa.Table) -> dict[str, Skeleton]:
    """The skeletons by fingerprint; raises `StoreError` with the first fault of the tables (`CHECKED_COLUMNS`)."""
    known: dict[str, Skeleton] = {}
    faults = chain(
        skeleton_faults(skeletons, known),
        sequence_faults(sequences, manifest, known),
        count_faults(manifest, sequences, skeletons),
    )
    for fault in faults:
        raise StoreError(
            f"the store {store} is damaged: {fault}: 'motionkit validate --store {store}' says all that is wrong; "
            "restore it from a copy, or ingest the sources into a new store"
        )
    return known


def skeleton_faults(skeletons: pa.Table, known: dict[str, Skeleton]) -> Iterator[str]:
    """One line for each fault of the table of skeletons; valid ones are added to `known` by fingerprint."""
    for row in skeletons.to_pylist():
        try:
            skeleton = _checked_skeleton(row)
        except (ValueError, MotionkitError) as error:
            yield f"{SKELETONS_FILE}: skeleton {row['skeleton']!r}: {error}"
            continue
        if row["skeleton"] in known:
            yield f"{SKELETONS_FILE}: skeleton {row['skeleton']!r} occurs more than once"
        known[row["skeleton"]] = skeleton


def _checked_skeleton(row: Mapping[str, Any]) -> Skeleton:
    num_joints = len(row["joint_names"])
    if not num_joints or len(row["offsets"]) != 3 * num_joints:
        raise ValueError(f"it has {num_joints} joints, but {len(row['offsets'])} numbers of offsets, not 3 for each")
    skeleton = codec.skeleton_from_row(dict(row))
    feet = row["feet"] or {}
    joints = [*feet.values(), *(joint for joint, _ in skeleton.end_sites)]
    joints += [joint for pair in skeleton.left_right_pairs for joint in pair]
    outside = [joint for joint in joints if not 0 <= joint < num_joints]
    if outside:
        raise ValueError(f"feet, pairs or end sites name joint {outside[0]} of {num_joints}")
    if not np.isfinite([*row["offsets"], *(number for _, tip in skeleton.end_sites for number in tip)]).all():
        raise ValueError("its offsets are not finite")
    if skeleton.layout_map:
        parse_layout_map(skeleton.layout_map)
    if skeleton.fingerprint != row["skeleton"]:
        raise ValueError(f"its joints are those of {skeleton.fingerprint!r}")
    return skeleton


def count_faults(manifest: Manifest, sequences: pa.Table | None, skeletons: pa.Table | None) -> Iterator[str]:
    """Differences between the manifest's counts and its files."""
    rows = sum(manifest.files[name].num_rows for name in manifest.parts)
    if rows < manifest.num_segments or (rows > manifest.num_segments and not may_hold_removed(manifest)):
        yield f"{MANIFEST_FILE}: counts {manifest.num_segments} segments, the parts hold {rows}"
    counts = []
    if sequences is not None:
        counts = [
            ("sequences", sequences.num_rows, manifest.num_sequences, SEQUENCES_FILE),
            ("segments", int(_whole(sequences, "num_segments").sum()), manifest.num_segments, SEQUENCES_FILE),
            ("frames", int(_whole(sequences, "num_frames").sum()), manifest.num_frames, SEQUENCES_FILE),
        ]
    if skeletons is not None:
        counts.append(("skeletons", skeletons.num_rows, manifest.num_skeletons, SKELETONS_FILE))
    for what, found, stated, name in counts:
        if found != stated:
            yield f"{MANIFEST_FILE}: counts {stated} {what}, {name} says {found}"


def may_hold_removed(manifest: Manifest) -> bool:
    """Whether parts may hold segments of sequences that were removed."""
    return manifest.next_sequence_index > manifest.num_sequences


def sequence_faults(sequences: pa.Table, manifest: Manifest, skeletons: Mapping[str, Skeleton] | None) -> Iterator[str]:
    """One line for each fault of the table of sequences (`CHECKED_COLUMNS`), and of its `skeletons` if given."""
    # Without removals the numbers below the next one are as many as the sequences: 0, 1, 2 …
    steps = np.diff(_whole(sequences, "sequence_index"), prepend=-1, append=manifest.next_sequence_index)
    if (steps < 1).any():
        yield f"{SEQUENCES_FILE}: sequence_index does not ascend from 0 to below {manifest.next_sequence_index}"
    ids = sequences["sequence_id"]
    if pc.count_distinct(ids).as_py() != len(ids):
        for each in pc.value_counts(ids).to_pylist():
            if each["counts"] > 1:
                yield f"{SEQUENCES_FILE}: the id {each['values']!r} occurs more than once"
    numbers = [part_number(name) for name in manifest.parts]
    for number in sorted(set(_whole(sequences, "part").tolist()) - set(numbers)):
        yield f"{SEQUENCES_FILE}: {part_name(number)} is referred to, but the manifest does not name it"
    wrong = _wrong_figures(sequences) | _wrong_places(sequences, manifest)
    if skeletons is not None:
        wrong |= _wrong_skeletons(sequences, skeletons)
    for says, rows in wrong.items():
        for row in np.flatnonzero(rows):
            yield f"{SEQUENCES_FILE}: sequence {ids[int(row)].as_py()!r}: {says}"


def _wrong_figures(sequences: pa.Table) -> dict[str, Bool[np.ndarray, "sequences"]]:
    numerator, denominator = (_whole(sequences, f"fps_{part}") for part in ("numerator", "denominator"))
    num_frames = _whole(sequences, "num_frames")
    usable = (numerator > 0) & (denominator > 0)
    rate = np.where(usable, numerator, 1) / np.where(usable, denominator, 1)
    return {
        "fps is not positive": ~usable,
        "fps is not fps_numerator / fps_denominator": usable & _differ(rate, sequences, "fps"),
        "it has no frames": num_frames < 1,
        "duration_seconds is not num_frames / fps": usable & _differ(num_frames / rate, sequences, "duration_seconds"),
        "seconds_between_frames is not 1 / fps": usable & _differ(1 / rate, sequences, "seconds_between_frames"),
        "start_seconds is not finite": ~np.isfinite(numbers_of(sequences["start_seconds"])),
        "num_segments does not fit num_frames": _whole(sequences, "num_segments") != -(-num_frames // SEGMENT_FRAMES),
    }


def _wrong_places(sequences: pa.Table, manifest: Manifest) -> dict[str, Bool[np.ndarray, "sequences"]]:
    part, first_row, count = (_whole(sequences, name) for name in ("part", "first_row", "num_segments"))
    numbers = np.array([part_number(name) for name in manifest.parts], np.int64)
    num_rows = np.array([manifest.files[name].num_rows for name in manifest.parts] + [0], np.int64)
    named = np.isin(part, numbers)
    of_part = num_rows[np.where(named, np.searchsorted(numbers, part), len(numbers))]
    return {"its segments do not lie inside of its part": named & ((first_row < 0) | (first_row + count > of_part))}


def _wrong_skeletons(
    sequences: pa.Table, skeletons: Mapping[str, Skeleton]
) -> dict[str, Bool[np.ndarray, "sequences"]]:
    names = sequences["skeleton"].combine_chunks().dictionary_encode()
    joints = [skeletons[name].num_joints if name in skeletons else 0 for name in names.dictionary.to_pylist()]
    expected = np.array(joints, np.int64)[numbers_of(names.indices)]
    return {
        f"its skeleton is not in {SKELETONS_FILE}": expected == 0,
        "num_joints is not its skeleton's": (expected > 0) & (expected != _whole(sequences, "num_joints")),
    }


def caption_faults(sequences: pa.Table) -> Iterator[str]:
    """One line for each caption with invalid seconds, or beyond its motion's end; the motion can still be read."""
    captions = sequences["captions"].combine_chunks()
    said = captions.values
    start, end = numbers_of(said.field("start_seconds")), numbers_of(pc.fill_null(said.field("end_seconds"), np.inf))
    row = np.searchsorted(numbers_of(captions.offsets), np.arange(len(said)), side="right") - 1
    stop = (numbers_of(sequences["start_seconds"]) + numbers_of(sequences["duration_seconds"]))[row]
    is_span = np.isfinite(start) & (start <= end)
    beyond = (start >= stop) | (np.isfinite(end) & (end > stop + CAPTION_TOLERANCE_SECONDS))
    for wrong in np.flatnonzero(~is_span | beyond):
        sequence_id = sequences["sequence_id"][int(row[wrong])].as_py()
        said_of = f"{SEQUENCES_FILE}: sequence {sequence_id!r}: a caption lasts from"
        past = f", the motion ends at {stop[wrong]:g} s" if is_span[wrong] else ""
        yield f"{said_of} {start[wrong]:g} to {end[wrong]:g} s{past}"


def _differ(
    expected: Float64[np.ndarray, "sequences"], sequences: pa.Table, name: str
) -> Bool[np.ndarray, "sequences"]:
    return np.asarray(~np.isclose(expected, numbers_of(sequences[name]), rtol=_RELATIVE_ERROR, atol=0.0))


def _whole(table: pa.Table, name: str) -> Int64[np.ndarray, "rows"]:
    return np.asarray(numbers_of(table[name]), np.int64)
