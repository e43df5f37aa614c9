"""Motions to look at: found by the names that people give, read whole with their holes."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from motionkit.errors import FormatError
from motionkit.formats.bvh.document import read_document
from motionkit.formats.items import ReadOptions, SourceItem
from motionkit.named_motions.found import Found, Readers, find_motions, find_stored
from motionkit.named_motions.holes import NAN, ReadClip, read_with_holes
from motionkit.named_motions.vectors_npy import read_vectors

# Of .bvh files: frames that a tracker lost, and a skeleton that is no human body.
READABLE_ALL_THE_SAME = frozenset({NAN, "unit"})

ViewSource = Found[ReadClip]


def find_sources(names: Sequence[str], options: ReadOptions, store: Path) -> tuple[list[ViewSource], list[FormatError]]:
    """The motions of these names, and what is wrong with some. Raises `UsageError` for a name that says nothing."""
    readers = Readers(partial(_read, options=options), lambda path: read_vectors(path, options), ReadClip.whole)
    return find_motions(names, options, store, readers)


def stored_where(store: Path, where: str) -> list[ViewSource]:
    """The stored sequences for which a condition holds, in the store's order; raises `StoreError` or `UsageError`."""
    return find_stored(store, where, ReadClip.whole)


def _read(item: SourceItem, options: ReadOptions) -> ReadClip:
    try:
        return read_with_holes(item, options)
    except FormatError as error:
        if error.reason not in READABLE_ALL_THE_SAME or item.path.suffix.lower() != ".bvh":
            raise
    document = read_document(item.path, options)
    return ReadClip(replace(document.motion(), captions=item.captions), document.seen)
