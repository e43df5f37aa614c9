"""PA-HiRes: any motion completed at any framerate, by a hierarchical continuous representation (arXiv 2512.21183)."""
