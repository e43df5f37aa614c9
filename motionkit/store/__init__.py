"""The store: Parquet is the record, a memory map is for training (docs/store.md)."""

from motionkit.store.encode import RefusedMotion
from motionkit.store.reader import Store
from motionkit.store.writer import StoreWriter

__all__ = ["RefusedMotion", "Store", "StoreWriter"]
