"""NeRM's tables and figures, one file each."""
