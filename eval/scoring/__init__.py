"""From embeddings to all of a table's numbers under a protocol; nothing here knows a network."""
