"""Shared parts of all readers: files, tables of numbers, clocks, units and axes."""
