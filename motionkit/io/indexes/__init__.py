"""Indexes: files that list the segments of motion files that form a corpus, with names and captions."""
