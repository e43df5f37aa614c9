"""Motion in, motion out: complete, plant, export."""
