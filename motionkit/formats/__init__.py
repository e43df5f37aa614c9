"""Formats: a file or a folder each, reader and writer together; `catalogue` lists them, `registry` finds and reads."""
