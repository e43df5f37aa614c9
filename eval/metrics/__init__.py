"""Metrics as pure float64 functions, and streams of them whose state is sums."""
