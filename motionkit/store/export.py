"""A store's motions as files again, with a table of what the files cannot hold."""

import csv
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path, PurePosixPath

from motionkit.errors import UsageError
from motionkit.formats.bvh import write_bvh
from motionkit.formats.joints_npy import write_joints_npy
from motionkit.motion import Motion
from motionkit.resample import resample
from motionkit.skeleton import SMPL22
from motionkit.skeleton_map import map_joints
from motionkit.store.reader import Store
from motionkit.timegrid import format_fps

TABLE = "motions.csv"
# As motionkit.formats.annotations reads them: of a motion's captions the first two, without their seconds.
COLUMNS = ("file", "caption", "caption_kit", "action", "split", "fps", "subject", "licence", "source", "subset")


def export_bvh(motions: Iterable[Motion], folder: Path) -> Iterator[Path]:
    """Write each motion to `folder/ID.bvh` on its own skeleton at its own framerate; yields the paths as they are."""
    return _export(motions, folder, ".bvh", write_bvh)


def export_joints(motions: Iterable[Motion], folder: Path) -> Iterator[Path]:
    """Write each motion's 22 joints in metres to `folder/ID.npy`, the framerate to `motions.json`; yields the paths.

    Slashes in an id become underscores. Raises `SkeletonMapError` for a skeleton without the 22 joints and `UsageError`
    where framerates differ: a folder of joints has one.
    """
    rates: set[Fraction] = set()

    def write(motion: Motion, path: Path) -> None:
        rates.add(motion.fps)
        if len(rates) > 1:
            found = " and ".join(format_fps(fps) for fps in sorted(rates))
            raise UsageError(f"a folder of joints has one framerate, the sequences have {found}: give one with --fps")
        joints = Motion(map_joints(motion, SMPL22.name), SMPL22, motion.timegrid, sequence_id=motion.sequence_id)
        write_joints_npy(joints, path)

    flat = (replace(motion, sequence_id=motion.sequence_id.replace("/", "_")) for motion in motions)
    return _export(flat, folder, ".npy", write)


EXPORTS: dict[str, Callable[[Iterable[Motion], Path], Iterator[Path]]] = {
    "bvh": export_bvh,
    "joints-npy": export_joints,
}


def motions_of(store: Store, where: str | None, fps: Fraction | None) -> Iterator[Motion]:
    """The motions that a SQL condition chooses, resampled where `fps` is given; the order is the store's."""
    for motion in store.read_many(store.select(where).tolist()):
        yield motion if fps is None else resample(motion, fps)


def _export(
    motions: Iterable[Motion], folder: Path, suffix: str, write: Callable[[Motion, Path], None]
) -> Iterator[Path]:
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file: name a new folder")
    if folder.exists() and any(folder.iterdir()):
        raise UsageError(f"{folder} is not empty: name a new folder")
    folder.mkdir(parents=True, exist_ok=True)
    written: set[Path] = set()
    with (folder / TABLE).open("w", encoding="utf-8", newline="") as handle:
        table = csv.DictWriter(handle, COLUMNS)
        table.writeheader()
        for motion in motions:
            path = folder / _relative_path(motion.sequence_id, suffix)
            if path in written:
                raise UsageError(f"two sequences would be written to {path}: choose one of them with --where")
            path.parent.mkdir(parents=True, exist_ok=True)
            write(motion, path)
            written.add(path)
            table.writerow(_table_row(motion, path.relative_to(folder)))
            yield path


def _relative_path(sequence_id: str, suffix: str) -> PurePosixPath:
    """An id as a path below a folder; ids come from files, so none may lead out of it."""
    parts = PurePosixPath(sequence_id).parts
    if not parts or parts[0] == "/" or ".." in parts or "\0" in sequence_id:
        raise UsageError(f"the id {sequence_id!r} cannot be a file's name: leave the sequence out with --where")
    return PurePosixPath(*parts[:-1], parts[-1] + suffix)


def _table_row(motion: Motion, path: Path) -> dict[str, str]:
    captions = [caption.text for caption in motion.captions[:2]]
    provenance = motion.provenance
    return {
        "file": path.as_posix(),
        "caption": captions[0] if captions else "",
        "caption_kit": captions[1] if len(captions) > 1 else "",
        "action": motion.action,
        "split": motion.split,
        "fps": format_fps(motion.fps),
        "subject": provenance.subject,
        "licence": provenance.licence,
        "source": provenance.source,
        "subset": provenance.subset,
    }
