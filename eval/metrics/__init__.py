"""Metrics as pure float64 functions."""
