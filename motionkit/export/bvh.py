"""A BVH file for each motion, on its own skeleton at its own framerate."""

from collections.abc import Iterator
from pathlib import Path

from motionkit.export.files import write_files
from motionkit.export.names import nested_names
from motionkit.export.selection import Outcome, Selection
from motionkit.formats.bvh.motion import write_bvh


def export_bvh(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write each motion to `folder/ID.bvh` in centimetres (`write_bvh`)."""
    return write_files(selection, folder, nested_names(selection.sequence_ids, ".bvh"), write_bvh)
