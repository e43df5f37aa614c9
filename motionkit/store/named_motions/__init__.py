"""Motions as people name them: files, folders, ids of a store; found, and read one by one with their holes."""
