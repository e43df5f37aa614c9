"""The store: Parquet files, and a memory map for training (docs/store.md)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
