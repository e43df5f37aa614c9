"""Export from a store: one module per output format, and the atomic output folder."""
