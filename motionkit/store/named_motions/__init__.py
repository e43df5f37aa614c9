"""Resolves motions by name (files, folders, ids of a store) and reads them, with missing frames if any."""
