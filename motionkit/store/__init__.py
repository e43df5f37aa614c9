"""The store: Parquet is the record, a memory map is for training."""
