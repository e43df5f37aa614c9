"""The store: Parquet files, and a memory map for training (docs/store.md)."""

from typing import TYPE_CHECKING

from motionkit.core.public_names import give_names

if TYPE_CHECKING:
    from motionkit.store.codec import RefusedMotion
    from motionkit.store.reader import Store
    from motionkit.store.writer import StoreWriter

__all__ = ["RefusedMotion", "Store", "StoreWriter"]

give_names(
    __name__,
    {
        "RefusedMotion": "motionkit.store.codec",
        "Store": "motionkit.store.reader",
        "StoreWriter": "motionkit.store.writer",
    },
)
