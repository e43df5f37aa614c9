"""Lists a folder of samples: its arrays, its motions of known formats, the CSV files beside them."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from eval.sample_folder.folder import SampleFolderError
from eval.sample_folder.manifest import MANIFEST, Manifest, read_manifest
from motionkit.core.errors import FormatError
from motionkit.io import annotations
from motionkit.io.annotations import Annotation
from motionkit.io.registry import SourceItem, recognise_folder
from motionkit.io.scan import scan, walk

ARRAY_SUFFIXES = (".npy", ".npz")
STATISTICS_NAMES = frozenset({"mean", "std"})
# What published code writes beside a sample X or X_pred.
COPIES = {"_gt": "real motions", "_ref": "real motions", "_ik": "foot-corrected copies"}
PROGRAMS = frozenset({".pkl", ".pickle", ".pt", ".pth", ".joblib"})
SHOWN_KINDS = 3
# Other formats are self-contained; these may be normalised, and state no framerate.
PLAIN_ARRAYS = frozenset({"joints-npy", "pose-vectors"})
# Problems of a scan that are reported differently here, or are none.
HANDLED_HERE = ("caption-without-motion", "empty-folder", "unknown-format")


@dataclass(frozen=True)
class Listing:
    """The files of one folder of samples: `arrays` are read here, `items` by motionkit's formats.

    `rows` are the CSV files' rows by file; `problems` are files that cannot be listed or recognised.
    """

    root: Path
    manifest: Manifest
    arrays: tuple[Path, ...]
    items: tuple[SourceItem, ...]
    rows: Mapping[Path, Annotation]
    problems: tuple[FormatError, ...]
    remarks: tuple[str, ...]

    @property
    def num_files(self) -> int:
        """Number of files to read (of sequences, for formats of whole folders)."""
        return len(self.arrays) + len(self.items)

    def place(self, path: Path) -> str:
        """A motion's id: its file's path relative to the folder, without suffix."""
        return path.relative_to(self.root).with_suffix("").as_posix()


def list_samples(name: str, source: Path) -> Listing:
    """List a folder (or one file) of samples.

    Raises `SampleFolderError` for an empty one, `FormatError` for a broken manifest.
    """
    if not source.exists():
        raise SampleFolderError(f"--samples {name}: there is no folder {str(source)!r}")
    root = (source if source.is_dir() else source.parent).resolve()
    manifest = read_manifest(root)
    only = None if source.is_dir() else root / source.name
    # What cannot be listed is one of the problems that `scan` finds below.
    folders = list(walk(root, _is_claimed, lambda error: None)) if only is None else [(root, [only])]
    rows, problems, warnings = _rows(folders)
    scanned = scan([source])
    known = {problem.path for problem in problems}
    problems += [each for each in scanned.problems if each.reason not in HANDLED_HERE and each.path not in known]
    items = [item for item in scanned.items if item.format not in PLAIN_ARRAYS]
    taken = {item.path for item in items}
    arrays = [
        path
        for folder, files in folders
        if only is not None or not _is_claimed(folder)
        for path in files
        if path.suffix.lower() in ARRAY_SUFFIXES and path not in taken
        if path not in (manifest.mean, manifest.std) and path.stem.lower() not in STATISTICS_NAMES
    ]
    # A glob matches the end of a path, whatever the folders before it.
    files, exclude = ([glob.removeprefix("**/") for glob in globs] for globs in (manifest.files, manifest.exclude))

    def is_chosen(path: Path) -> bool:
        place = PurePosixPath(path.relative_to(root).as_posix())
        return (not files or any(map(place.match, files))) and not any(map(place.match, exclude))

    arrays, items = [path for path in arrays if is_chosen(path)], [item for item in items if is_chosen(item.path)]
    remarks: list[str] = []
    if not files:
        arrays, items, remarks = _without_copies(arrays, items)
    if not arrays and not items and not problems:
        raise SampleFolderError(f"--samples {name}: {_nothing(source, folders, manifest)}")
    remarks += [f"{warning.path.name}: {warning.message}" for warning in warnings]
    absent = [path for path in rows if not os.path.exists(path)]  # noqa: PTH110 (a name may be too long)
    if absent:
        remarks.append(f"{len(absent):,} rows of the CSV describe files that are not there, first {absent[0].name!r}")
    return Listing(root, manifest, tuple(arrays), tuple(items), rows, tuple(problems), tuple(remarks))


def _is_claimed(folder: Path) -> bool:
    return recognise_folder(folder) is not None


def _rows(
    folders: Sequence[tuple[Path, list[Path]]],
) -> tuple[dict[Path, Annotation], list[FormatError], list[FormatError]]:
    """All rows of the CSV files in these folders, problems and warnings; the CSV nearest to a file wins."""
    rows: dict[Path, Annotation] = {}
    problems: list[FormatError] = []
    warnings: list[FormatError] = []
    for folder, _ in folders:
        tables, broken = annotations.tables_in(folder)
        problems += broken
        for table in tables:
            rows |= table.rows
            problems += table.problems
            warnings += table.warnings
    return rows, problems, warnings


def _without_copies(arrays: list[Path], items: list[SourceItem]) -> tuple[list[Path], list[SourceItem], list[str]]:
    """Drop extra files that published code writes beside each sample."""
    paths = [*arrays, *(item.path for item in items)]
    stems = {path.with_suffix("") for path in paths}
    dropped: Counter[str] = Counter()
    copies = set()
    for path in paths:
        ending = next((ending for ending in COPIES if path.stem.endswith(ending)), "")
        base = path.with_name(path.stem.removesuffix(ending))
        if ending and stems & {base, base.with_name(f"{base.name}_pred")}:
            copies.add(path)
            dropped[f"{COPIES[ending]} (*{ending})"] += 1
    arrays, items = [path for path in arrays if path not in copies], [item for item in items if item.path not in copies]
    named, files = {path.stem for path in arrays}, [item for item in items if not item.key]
    if files and all(item.path.stem in named for item in files):
        items = [item for item in items if item.key]
        dropped[f"{files[0].path.suffix} files of the same names as the arrays"] += len(files)
    return arrays, items, [f'{count:,} {what} left out (files = ["…"] chooses)' for what, count in dropped.items()]


def _nothing(source: Path, folders: Sequence[tuple[Path, list[Path]]], manifest: Manifest) -> str:
    kinds = Counter(path.suffix.lower() or path.name for _, files in folders for path in files)
    there = ", ".join(f"{count:,} {kind}" for kind, count in kinds.most_common(SHOWN_KINDS)) or "no files"
    if manifest.files or manifest.exclude:
        there += f"; files and exclude in {MANIFEST} choose among them"
    pickles = " (a .pkl or .pt can execute code: export its arrays, docs/samples.md)" if kinds.keys() & PROGRAMS else ""
    return (
        f"no motion was found in {str(source)!r}: it has {there}{pickles}; expected .npy, .npz, .bvh or another format"
    )
