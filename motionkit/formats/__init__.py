"""Formats: one file each, reader and writer side by side."""
