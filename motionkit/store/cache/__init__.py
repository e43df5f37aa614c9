"""Training caches: memory maps built from a store."""
