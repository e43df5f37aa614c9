"""The drill: kills, damaged files, malformed input, hostile folders and load; `python -m benchmarks.trust PART`."""
