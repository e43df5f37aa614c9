"""Sources into a store."""

# What the processes that read sources import, once for all of them.
PRELOADED = ("motionkit.store.ingest.stretches",)
