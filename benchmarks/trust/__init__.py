"""The drill: kills, damaged files, malformed input and load; `python -m benchmarks.trust PART`."""
