"""Selection → folder: written beside its place and renamed when it is complete."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import whole_folder
from motionkit.export.catalogue import Export
from motionkit.export.selection import Outcome, Selection


@dataclass(frozen=True)
class ExportReport:
    """What an export did: sequences and files written, their bytes, and the sequences left out with the reason."""

    folder: Path
    format: str
    num_sequences: int
    num_files: int
    num_bytes: int
    left_out: tuple[Outcome, ...]

    @property
    def left_out_by_reason(self) -> dict[str, int]:
        """Number of sequences left out by the reason, most frequent first."""
        return dict(Counter(outcome.reason for outcome in self.left_out).most_common())


def export(
    selection: Selection, folder: Path, kind: Export, on_outcome: Callable[[Outcome], None] = lambda outcome: None
) -> ExportReport:
    """Write a selection as one kind of output into a new or empty folder; `on_outcome` is told about each sequence.

    Everything is written into `FOLDER.partial`; `FOLDER` appears when it is complete, and nothing is left when anything
    raises (`whole_folder`). Raises `UsageError` for a folder that holds something or that another process writes,
    `MotionkitError` where nothing could be written.
    """
    # A link to an empty folder is filled where it points.
    place = folder.absolute().resolve() if folder.is_symlink() else folder.absolute()
    left_out: list[Outcome] = []
    num_sequences = 0
    with whole_folder(place) as partial:
        # Under its lock, and after what a killed export left is deleted.
        _require_empty(folder)
        for outcome in kind.write(selection, partial):
            if outcome.written:
                num_sequences += 1
            else:
                left_out.append(outcome)
            on_outcome(outcome)
        if not num_sequences:
            first = left_out[0].message if left_out else "the selection is empty"
            raise MotionkitError(f"none of {len(left_out)} sequences can be written as {kind.name}, first: {first}")
        sizes = [path.stat().st_size for path in partial.rglob("*") if path.is_file()]
    return ExportReport(folder, kind.name, num_sequences, len(sizes), sum(sizes), tuple(left_out))


def _require_empty(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file: name a new folder")
    if folder.exists() and any(folder.iterdir()):
        raise UsageError(f"{folder} is not empty: name a new folder")
