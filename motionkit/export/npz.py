"""An .npz file of the project's schema for each motion: everything that the store knows of it."""

from collections.abc import Iterator
from pathlib import Path

from motionkit.export.files import write_files
from motionkit.export.names import nested_names
from motionkit.export.selection import Outcome, Selection
from motionkit.formats.arrays.npz import write_npz


def export_npz(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write each motion to `folder/ID.npz` (`motionkit.formats.arrays.npz`)."""
    return write_files(selection, folder, nested_names(selection.sequence_ids, ".npz"), write_npz)
