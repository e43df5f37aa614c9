"""A store of the selected sequences with a card: Parquet for `datasets`, pandas, polars and duckdb."""

from collections.abc import Iterator
from pathlib import Path

from motionkit.edit.export.files import Outcome, Selection
from motionkit.store import Store, StoreWriter
from motionkit.store.commit import LOCK_FILE
from motionkit.store.hub import store_card
from motionkit.store.reports.summary import summarise


def export_parquet(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write a store with the selection, and its card (README.md)."""
    with StoreWriter.create(folder) as writer:
        for motion in selection.motions():
            writer.add(motion)
            yield Outcome(motion.sequence_id)
    (folder / LOCK_FILE).unlink()
    card = store_card(summarise(Store.open(folder)), "OUT")
    (folder / "README.md").write_text(card, encoding="utf-8")
