"""BVH: hierarchy, channels and motion, and the data sets that name their BVH files."""
