"""A CSV table of joint positions for each motion: what a spreadsheet or any script reads."""

from collections.abc import Iterator
from pathlib import Path

from motionkit.export.files import write_files
from motionkit.export.names import nested_names
from motionkit.export.selection import Outcome, Selection
from motionkit.formats.joints_csv import write_joints_csv


def export_joints_csv(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write each motion's joints in metres to `folder/ID.csv` (`motionkit.formats.joints_csv`); bones are not kept."""
    return write_files(selection, folder, nested_names(selection.sequence_ids, ".csv"), write_joints_csv)
