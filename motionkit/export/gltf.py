"""A .glb for each motion: an animated, visible skeleton at the motion's own framerate."""

from collections.abc import Iterator
from pathlib import Path

from motionkit.export.files import write_files
from motionkit.export.names import nested_names
from motionkit.export.selection import Outcome, Selection
from motionkit.formats.gltf.motion import write_gltf


def export_gltf(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write each motion to `folder/ID.glb` (`motionkit.formats.gltf.motion`)."""
    return write_files(selection, folder, nested_names(selection.sequence_ids, ".glb"), write_gltf)
