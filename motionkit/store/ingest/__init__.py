"""Ingests sources into a store."""

# Imported once for all worker processes.
PRELOADED = ("motionkit.store.ingest.stretches",)
