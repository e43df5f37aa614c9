"""Indexes: files that say which stretches of which motion files make a corpus, under which names and captions."""
