"""Taking sequences out of a store: their rows go at once, their frames with the next `motionkit compact`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from motionkit.store.commit import changing, describe_pending, publish, require_present_version, write_pending
from motionkit.store.manifest import Manifest
from motionkit.store.reader import Store
from motionkit.store.schema import SEQUENCES_FILE, part_number


def remove(path: Path, sequence_ids: Sequence[str] = (), *, where: str | None = None) -> tuple[str, ...]:
    """Remove the sequences with these ids and those for which the SQL condition holds; the removed ids, in order.

    Only the table of sequences is written again. The others keep their `sequence_index`, and a number that was removed
    is not given again before the store is compacted. Parts that hold nothing else are deleted. Raises `StoreError` for
    an id that the store does not hold and for a store that is missing, busy or of an earlier version; `UsageError` for
    bad SQL.
    """
    with changing(path, must_exist=True) as previous:
        require_present_version(path, previous)
        store = Store.open(path)
        chosen = {store.index_of(sequence_id) for sequence_id in sequence_ids}
        if where is not None:
            chosen.update(store.select(where).tolist())
        if not chosen:
            return ()
        gone = pc.is_in(store.sequences_table["sequence_index"], pa.array(sorted(chosen), pa.int32()))
        removed = store.sequences_table["sequence_id"].filter(gone).to_pylist()
        publish(path, _without(path, previous, store.sequences_table.filter(pc.invert(gone))))
        return tuple(removed)


def _without(path: Path, previous: Manifest, kept: pa.Table) -> Manifest:
    """Write the table of what is kept and describe the store that it makes."""
    write_pending(path, SEQUENCES_FILE, kept)
    live = set(np.unique(kept["part"].to_numpy()).tolist())
    dead = {name for name in previous.parts if part_number(name) not in live}
    entries = {name: entry for name, entry in previous.files.items() if name not in dead}
    return replace(
        previous,
        num_sequences=kept.num_rows,
        num_segments=int(pc.sum(kept["num_segments"]).as_py() or 0),
        num_frames=int(pc.sum(kept["num_frames"]).as_py() or 0),
        files=entries | describe_pending(path, {SEQUENCES_FILE: kept.num_rows}),
    )
