"""Removes sequences from stores, compacts stores in place, and merges stores."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from motionkit.core.errors import StoreError, UsageError, describe
from motionkit.core.shapes import Int
from motionkit.store.cache import remove_stale_caches
from motionkit.store.commit import Manifest, changing, committed, publish, write_pending
from motionkit.store.reader import Store
from motionkit.store.schema import MANIFEST_FILE, PART_BYTES, SEQUENCES_FILE, part_name
from motionkit.store.writer import StoreWriter

OnSequence = Callable[[], None]
SHOWN_CONFLICTS = 5


def remove(path: Path, sequence_ids: Sequence[str] = (), *, where: str | None = None) -> tuple[str, ...]:
    """Remove the sequences with these ids and those that satisfy the SQL condition; returns the removed ids, in order.

    Only the table of sequences is written again. The others keep their `sequence_index`, and a removed number is not
    assigned again before the store is compacted. Parts that hold nothing else are deleted. Raises `StoreError` for an
    id that the store does not hold and for a missing store; `BusyError` while another process writes to it;
    `UsageError` for bad SQL.
    """
    with changing(path, must_exist=True) as previous:
        removed, kept = _divided(Store.open(path), sequence_ids, where)
        if removed.num_rows:
            unused = set(previous.parts) - set(map(part_name, kept["part"].unique().to_pylist()))
            entries = {name: entry for name, entry in previous.files.items() if name not in unused}
            entries[SEQUENCES_FILE] = write_pending(path, SEQUENCES_FILE, kept)
            publish(path, replace(previous, files=entries))
        return tuple(removed["sequence_id"].to_pylist())


@dataclass(frozen=True)
class Removal:
    """What `remove` would delete: ids, in order, and about how many bytes.

    `bytes_at_once` are those of parts that hold nothing else; `bytes_later` are freed by `compact`.
    """

    sequence_ids: tuple[str, ...]
    bytes_at_once: int
    bytes_later: int


def plan_removal(path: Path, sequence_ids: Sequence[str] = (), *, where: str | None = None) -> Removal:
    """What `remove` would do with these arguments, without changing anything; raises as `remove` does."""
    store = Store.open(path)
    removed_rows, kept_rows = _divided(store, sequence_ids, where)
    removed, kept = (_bytes_of(store.manifest, rows) for rows in (removed_rows, kept_rows))
    at_once = sum(store.manifest.files[name].num_bytes for name in removed.keys() - kept.keys())
    later = sum(removed[name] for name in removed.keys() & kept.keys())
    return Removal(tuple(removed_rows["sequence_id"].to_pylist()), at_once, later)


def _divided(store: Store, sequence_ids: Sequence[str], where: str | None) -> tuple[pa.Table, pa.Table]:
    """The rows of the sequences to remove, and the other rows."""
    chosen = {store.index_of(sequence_id) for sequence_id in sequence_ids}
    if where is not None:
        chosen.update(store.select(where).tolist())
    is_chosen = pc.is_in(store.sequences_table["sequence_index"], pa.array(sorted(chosen), pa.int32()))
    return store.sequences_table.filter(is_chosen), store.sequences_table.filter(pc.invert(is_chosen))


def _bytes_of(manifest: Manifest, sequences: pa.Table) -> dict[str, int]:
    """Approximate bytes of these sequences by part, as their share of its rows."""
    counts = Counter(map(part_name, sequences["part"].to_pylist()))
    entries = {name: manifest.files[name] for name in counts}
    return {name: round(entry.num_bytes * counts[name] / entry.num_rows) for name, entry in entries.items()}


def compact(path: Path, on_sequence: OnSequence = lambda: None, *, part_bytes: int = PART_BYTES) -> bool:
    """Rewrite a store into full parts without removed sequences, numbered 0, 1, 2 …; False if nothing changes.

    Figures and frames are copied as they are: the parts and rows are those of one ingest of the same motions, but for
    the numbers of the parts, which go on. Until the commit the disk holds both; then the old parts and the training
    caches of earlier states are deleted, also those that a stopped command left. Raises `StoreError` where there is no
    store, or it is damaged; `BusyError` while another process writes to it.
    """
    with changing(path, must_exist=True) as manifest:
        is_compact = _is_compact(manifest, part_bytes)
    if not is_compact:
        with StoreWriter.create(path, overwrite=True, part_bytes=part_bytes) as writer:
            # Opened under the lock, so that sequences added by other writers aren't missed.
            store = Store.open(path)
            for motion in store.read_encoded(store.select()):
                writer.add_encoded(motion)
                on_sequence()
    try:
        remove_stale_caches(path, committed(path).fingerprint)
    except OSError as error:
        raise StoreError(
            f"the change of the store {path} is committed, but an old training cache cannot be deleted "
            f"({describe(error)}): delete its folder"
        ) from error
    return not is_compact


@dataclass(frozen=True)
class Compaction:
    """What `compact` would do, with numbers of parts and bytes; `bytes_after` is an estimate."""

    is_compact: bool
    num_parts: int
    num_bytes: int
    bytes_after: int
    num_removed: int


def plan_compaction(path: Path, *, part_bytes: int = PART_BYTES) -> Compaction:
    """What `compact` would do, without changing anything; raises as `compact` does, except for a busy store."""
    store = Store.open(path)
    manifest = store.manifest
    return Compaction(
        is_compact=_is_compact(manifest, part_bytes),
        num_parts=len(manifest.parts),
        num_bytes=sum(manifest.files[name].num_bytes for name in manifest.parts),
        bytes_after=sum(_bytes_of(manifest, store.sequences_table).values()),
        num_removed=manifest.num_removed,
    )


def _is_compact(manifest: Manifest, part_bytes: int) -> bool:
    is_full = all(manifest.files[name].num_bytes >= part_bytes for name in manifest.parts[:-1])
    return is_full and manifest.next_sequence_index == manifest.num_sequences


@dataclass(frozen=True)
class MergeReport:
    """Result of a merge: sequences stored, those already there, and the ids of conflicts left out."""

    store: Path
    num_stored: int
    num_already_stored: int
    conflicts: tuple[str, ...]
    num_in_store: int


def merge(
    out: Path,
    sources: Sequence[Path],
    *,
    where: str | None = None,
    on_conflict: Literal["stop", "skip"] = "stop",
    on_start: Callable[[int], None] = lambda num_sequences: None,
    on_sequence: OnSequence = lambda: None,
) -> MergeReport:
    """Copy the sequences of stores, or those for which a SQL condition holds, into one, which is created or added to.

    Order is that of the sources and of their sequences; frames and figures are copied as they are. A sequence that
    `out` or an earlier source holds from an equal file is left alone; the same id from another file is a conflict:
    under `stop` nothing is written, under `skip` the first one stays. Raises `StoreError` for conflicts and for stores
    that are missing or damaged; `BusyError` while another process writes to `out`; `UsageError` for bad SQL or where
    nothing is chosen.
    """
    stores = [Store.open(path) for path in sources]
    chosen = [store.select(where) for store in stores]
    if not any(map(len, chosen)):
        raise UsageError("no sequence of the sources is chosen" + (f" by {where!r}" if where else ""))
    appends = (out / MANIFEST_FILE).exists()
    with StoreWriter.append(out) if appends else StoreWriter.create(out) as writer:
        sha256_of: dict[str, str] = {}
        new: list[Int[np.ndarray, new]] = []
        num_known, conflicts = 0, []
        for store, indices in zip(stores, chosen, strict=True):
            columns = store.columns("sequence_id", "source_sha256").loc[indices]
            kept = []
            for index, sequence_id, sha256 in columns.itertuples(name=None):
                if sequence_id not in sha256_of and not writer.holds(sequence_id):
                    sha256_of[sequence_id] = sha256
                    kept.append(index)
                elif (sha256 and sha256_of.get(sequence_id) == sha256) or writer.holds_from(sequence_id, sha256):
                    num_known += 1
                else:
                    conflicts.append(sequence_id)
            new.append(np.array(kept, np.int64))
        if conflicts and on_conflict == "stop":
            names = ", ".join(map(repr, conflicts[:SHOWN_CONFLICTS]))
            more = f" and {len(conflicts) - SHOWN_CONFLICTS} more" if len(conflicts) > SHOWN_CONFLICTS else ""
            raise StoreError(
                f"{len(conflicts)} ids stand for different files: {names}{more}: leave them out with --where, or keep "
                "the first of each with --on-conflict skip"
            )
        on_start(len(sha256_of))
        for store, indices in zip(stores, new, strict=True):
            for motion in store.read_encoded(indices):
                writer.add_encoded(motion)
                on_sequence()
    return MergeReport(out, len(sha256_of), num_known, tuple(conflicts), committed(out).num_sequences)
