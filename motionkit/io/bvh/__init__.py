"""BVH: hierarchy, channels and motion, and the data sets published as BVH."""
