"""Readers and writers of file and folder formats, listed in `catalogue`; `scan` finds and reads sequences."""
