"""Adds random motion above 10 Hz, with the power that captures have there: a motion field that wraps another."""
