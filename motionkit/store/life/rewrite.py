"""Removes sequences from stores, compacts stores in place, and merges stores."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
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
from motionkit.store.schema import MANIFEST_FILE, PART_BYTES, SEQUENCES_FILE, part_name, part_number
from motionkit.store.writer import StoreWriter

OnSequence = Callable[[], None]
OnConflict = Literal["stop", "skip"]
SHOWN_CONFLICTS = 5


def remove(path: Path, sequence_ids: Sequence[str] = (), *, where: str | None = None) -> tuple[str, ...]:
    """Removes the sequences with these ids and those that satisfy the SQL condition; returns the removed ids, in order.

    Only the table of sequences is written again. The others keep their `sequence_index`, and a number that was removed
    is not given again before the store is compacted. Parts that hold nothing else are deleted. Raises `StoreError` for
    an id that the store does not hold and for a missing store; `BusyError` while
    another process writes to it; `UsageError` for bad SQL.
    """
    with changing(path, must_exist=True) as previous:
        removed, kept = _divided(Store.open(path), sequence_ids, where)
        if removed.num_rows:
            publish(path, _without(path, previous, kept))
        return tuple(removed["sequence_id"].to_pylist())


def _divided(store: Store, sequence_ids: Sequence[str], where: str | None) -> tuple[pa.Table, pa.Table]:
    """The rows of the sequences to remove, and the other rows."""
    chosen = {store.index_of(sequence_id) for sequence_id in sequence_ids}
    if where is not None:
        chosen.update(store.select(where).tolist())
    gone = pc.is_in(store.sequences_table["sequence_index"], pa.array(sorted(chosen), pa.int32()))
    return store.sequences_table.filter(gone), store.sequences_table.filter(pc.invert(gone))


def _without(path: Path, previous: Manifest, kept: pa.Table) -> Manifest:
    """Writes the table of the kept sequences and returns the new state."""
    live = set(np.unique(kept["part"].to_numpy()).tolist())
    dead = {name for name in previous.parts if part_number(name) not in live}
    entries = {name: entry for name, entry in previous.files.items() if name not in dead}
    return replace(previous, files={**entries, SEQUENCES_FILE: write_pending(path, SEQUENCES_FILE, kept)})


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
    removed, kept = _divided(store, sequence_ids, where)
    going, staying = _bytes_of(store.manifest, removed), _bytes_of(store.manifest, kept)
    at_once = sum(store.manifest.files[name].num_bytes for name in going.keys() - staying.keys())
    later = sum(going[name] for name in going.keys() & staying.keys())
    return Removal(tuple(removed["sequence_id"].to_pylist()), at_once, later)


def _bytes_of(manifest: Manifest, sequences: pa.Table) -> dict[str, int]:
    """Approximate bytes of these sequences per part, by their share of its rows."""
    counts = Counter(map(part_name, sequences["part"].to_pylist()))
    entries = {name: manifest.files[name] for name in counts}
    return {name: round(entry.num_bytes * counts[name] / entry.num_rows) for name, entry in entries.items()}


def compact(path: Path, on_sequence: OnSequence = lambda: None, *, part_bytes: int = PART_BYTES) -> bool:
    """Rewrites a store into full parts without removed sequences, numbered 0, 1, 2 …; False if nothing changes.

    Figures and frames are copied as they are: the parts and rows are those of one ingest of the same motions, but for
    the numbers of the parts, which go on. Until the commit the disk holds both; then the old parts and the training
    caches of earlier states are deleted, also those that a stopped command left. Raises `StoreError` where there is no
    store, or it is damaged; `BusyError` while another process writes to it.
    """
    with changing(path, must_exist=True) as manifest:
        is_compact = _is_compact(manifest, part_bytes)
    if not is_compact:
        _write_anew(path, part_bytes, on_sequence)
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
    size = sum(manifest.files[name].num_bytes for name in manifest.parts)
    after = sum(_bytes_of(manifest, store.sequences_table).values())
    compact = _is_compact(manifest, part_bytes)
    return Compaction(compact, len(manifest.parts), size, after, manifest.num_removed)


def _is_compact(manifest: Manifest, part_bytes: int) -> bool:
    full = all(manifest.files[name].num_bytes >= part_bytes for name in manifest.parts[:-1])
    return full and manifest.next_sequence_index == manifest.num_sequences


def _write_anew(path: Path, part_bytes: int, on_sequence: OnSequence) -> None:
    with StoreWriter.create(path, overwrite=True, part_bytes=part_bytes) as writer:
        # Opened under the lock, so that sequences added by other writers aren't missed.
        store = Store.open(path)
        for motion in store.read_encoded(store.select()):
            writer.add_encoded(motion)
            on_sequence()


@dataclass(frozen=True)
class MergeReport:
    """Result of a merge: sequences stored, those already there, and the ids of conflicts left out."""

    store: Path
    num_stored: int
    num_already_stored: int
    conflicts: tuple[str, ...]
    num_in_store: int


@dataclass(frozen=True, eq=False)
class _Choice:
    """Sequences to copy from one source of a merge."""

    store: Store
    indices: Int[np.ndarray, "chosen"]


def merge(
    out: Path,
    sources: Sequence[Path],
    *,
    where: str | None = None,
    on_conflict: OnConflict = "stop",
    on_start: Callable[[int], None] = lambda num_sequences: None,
    on_sequence: OnSequence = lambda: None,
) -> MergeReport:
    """Copy the sequences of stores, or those for which a SQL condition holds, into one, which is made or added to.

    Order is that of the sources and of their sequences; frames and figures are copied as they are. A sequence that
    `out` or an earlier source holds from an equal file is left alone; the same id from another file is a conflict:
    under `stop` nothing is written, under `skip` the first one stays. Raises `StoreError` for conflicts and for stores
    that are missing or damaged; `BusyError` while another process writes to `out`; `UsageError` for bad SQL or where
    nothing is chosen.
    """
    stores = [Store.open(path) for path in sources]
    chosen = [_Choice(store, store.select(where)) for store in stores]
    if not any(len(choice.indices) for choice in chosen):
        raise UsageError("no sequence of the sources is chosen" + (f" by {where!r}" if where else ""))
    appends = (out / MANIFEST_FILE).exists()
    with StoreWriter.append(out) if appends else StoreWriter.create(out) as writer:
        news, num_known, conflicts = _new_sequences(chosen, writer)
        if conflicts and on_conflict == "stop":
            raise StoreError(_conflict_message(conflicts))
        num_new = sum(len(choice.indices) for choice in news)
        on_start(num_new)
        for choice in news:
            for motion in choice.store.read_encoded(choice.indices):
                writer.add_encoded(motion)
                on_sequence()
    return MergeReport(out, num_new, num_known, tuple(conflicts), committed(out).num_sequences)


def _new_sequences(chosen: Iterable[_Choice], writer: StoreWriter) -> tuple[list[_Choice], int, list[str]]:
    """The sequences to copy, the number of those already there, and the ids of conflicts."""
    seen: dict[str, str] = {}
    news, num_known, conflicts = [], 0, []
    for choice in chosen:
        columns = choice.store.columns("sequence_id", "source_sha256").loc[choice.indices]
        kept = []
        for index, sequence_id, sha256 in columns.itertuples(name=None):
            if sequence_id not in seen and not writer.holds(sequence_id):
                seen[sequence_id] = sha256
                kept.append(index)
            elif (sha256 and seen.get(sequence_id) == sha256) or writer.holds_from(sequence_id, sha256):
                num_known += 1
            else:
                conflicts.append(sequence_id)
        news.append(_Choice(choice.store, np.array(kept, np.int64)))
    return news, num_known, conflicts


def _conflict_message(conflicts: Sequence[str]) -> str:
    names = ", ".join(map(repr, conflicts[:SHOWN_CONFLICTS]))
    more = f" and {len(conflicts) - SHOWN_CONFLICTS} more" if len(conflicts) > SHOWN_CONFLICTS else ""
    return (
        f"{len(conflicts)} ids stand for different files: {names}{more}: leave them out with --where, or keep the "
        "first of each with --on-conflict skip"
    )
