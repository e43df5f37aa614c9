"""Writes a selection to a folder, atomically, in one of all formats."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

from motionkit.core.errors import MotionkitError
from motionkit.core.files import require_empty, whole_folder
from motionkit.edit.export.files import Outcome, Selection, export_files
from motionkit.edit.export.pose_folder import HUMANML3D_KIND, KIT_KIND, export_pose_folder
from motionkit.io.registry import writers
from motionkit.store import Store, StoreWriter
from motionkit.store.commit import LOCK_FILE
from motionkit.store.hub import store_card
from motionkit.store.reports import summarise


@dataclass(frozen=True)
class Export:
    """An output format: `write` fills an empty folder and yields the outcome of each sequence, in order.

    `fps` is the default framerate of all motions; None keeps each at its own. Unsupported requests raise `UsageError`
    before the first frame is read.
    """

    name: str
    write: Callable[[Selection, Path], Iterator[Outcome]]
    fps: Fraction | None = None


def export_kinds() -> Mapping[str, Export]:
    """All output formats: a file per motion in every writable format, and data sets."""
    kinds = (
        *(Export(name, partial(export_files, format=each)) for name, each in writers().items()),
        Export("humanml3d", partial(export_pose_folder, kind=HUMANML3D_KIND), HUMANML3D_KIND.layout.fps),
        Export("kit", partial(export_pose_folder, kind=KIT_KIND), KIT_KIND.layout.fps),
        Export("parquet", export_parquet),
    )
    return {kind.name: kind for kind in kinds}


def export_parquet(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write a store with the selection, and its card (README.md): Parquet for `datasets`, pandas, polars, duckdb."""
    with StoreWriter.create(folder) as writer:
        for motion in selection.motions():
            writer.add(motion)
            yield Outcome(motion.sequence_id)
    (folder / LOCK_FILE).unlink()
    (folder / "README.md").write_text(store_card(summarise(Store.open(folder)), "OUT"), encoding="utf-8")


@dataclass(frozen=True)
class ExportReport:
    """The result of an export: sequences and files written, their bytes, and skipped sequences with reasons.

    `missing` has the ids of written sequences by missing metadata that the format's readers need.
    """

    folder: Path
    format: str
    num_sequences: int
    num_files: int
    num_bytes: int
    left_out: tuple[Outcome, ...]
    missing: Mapping[str, Sequence[str]]

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "folder": str(self.folder),
            "format": self.format,
            "sequences": self.num_sequences,
            "files": self.num_files,
            "bytes": self.num_bytes,
            "left_out": [
                {"sequence_id": outcome.sequence_id, "reason": outcome.reason, "message": outcome.message}
                for outcome in self.left_out
            ],
            "missing": {what: list(sequence_ids) for what, sequence_ids in self.missing.items()},
        }


def export(
    selection: Selection, folder: Path, kind: Export, on_outcome: Callable[[Outcome], None] = lambda outcome: None
) -> ExportReport:
    """Write a selection in one format into a new or empty folder; `on_outcome` is called for each sequence.

    Everything is written into `FOLDER.partial`, which is renamed when complete and deleted on errors (`whole_folder`).
    Raises `UsageError` for a folder that is not empty, `BusyError` for one that another process writes,
    `MotionkitError` if nothing could be written.
    """
    left_out: list[Outcome] = []
    missing: dict[str, list[str]] = {}
    num_sequences = 0
    # A link to an empty folder is filled where it points.
    with whole_folder(folder.resolve() if folder.is_symlink() else folder.absolute()) as partial_folder:
        # Under the lock, after leftovers of a killed export are deleted.
        require_empty(folder)
        for outcome in kind.write(selection, partial_folder):
            if outcome.reason:
                left_out.append(outcome)
            else:
                num_sequences += 1
                for what in outcome.lacks:
                    missing.setdefault(what, []).append(outcome.sequence_id)
            on_outcome(outcome)
        if not num_sequences:
            first = left_out[0].message if left_out else "the selection is empty"
            raise MotionkitError(f"none of {len(left_out)} sequences can be written as {kind.name}, first: {first}")
        sizes = [path.stat().st_size for path in partial_folder.rglob("*") if path.is_file()]
    return ExportReport(folder, kind.name, num_sequences, len(sizes), sum(sizes), tuple(left_out), missing)
