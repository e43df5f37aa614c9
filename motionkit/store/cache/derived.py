"""Numbers of every frame that follow from a cache's sequences, computed once and kept beside its positions."""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32

from motionkit.core.checksums import read_json, write_json
from motionkit.core.errors import DamagedFileError
from motionkit.core.progress import warn
from motionkit.store.cache.folder import writable
from motionkit.store.cache.row_file import RowFile, write_rows
from motionkit.store.digests import FileDigest, file_fault
from motionkit.store.lock import exclusive_lock

if TYPE_CHECKING:
    from motionkit.store.cache.positions import PositionCache


def derived_rows(
    cache: "PositionCache",
    name: str,
    num_numbers: int,
    compute: Callable[[], Iterator[Float32[np.ndarray, "frames numbers"]]],
) -> RowFile:
    """A file with a row of numbers for each row of `cache.positions`, made where it is missing or damaged.

    `compute` gives the sequences' rows in the cache's order, one sequence in memory at a time. `name` stands for how
    they are computed: a change of that needs another name. The file goes when the cache goes. Two processes may ask at
    once: one computes, the other waits. Raises `ValueError` where the rows are not those of the cache's frames,
    `StoreError` where the cache may not be written to.
    """
    shape = (len(cache.positions), num_numbers)
    found = _find(cache.path, name, shape)
    if isinstance(found, RowFile):
        return found
    with writable(found), exclusive_lock(cache.path / f".{name}.lock", busy=None):
        found = _find(cache.path, name, shape)
        if isinstance(found, RowFile):
            return found
        if found is not None:
            warn(str(found))
        digest = write_rows(cache.path / f"{name}.npy", shape, _checked(name, cache, num_numbers, compute()))
        write_json(cache.path / f"{name}.json", asdict(digest))
    return RowFile.open(cache.path / f"{name}.npy")


def derived_faults(folder: Path) -> Iterator[DamagedFileError]:
    """What is wrong with the derived files in a cache's folder, all their bytes compared."""
    for record in sorted(folder.glob("*.json")):
        if (folder / f".{record.stem}.lock").exists():
            try:
                _require_intact(record, deep=True)
            except DamagedFileError as error:
                yield error


def _find(folder: Path, name: str, shape: tuple[int, int]) -> RowFile | DamagedFileError | None:
    """The rows of a name, or what is wrong with them, or None where there are none."""
    record = folder / f"{name}.json"
    if not record.exists():
        return None
    try:
        _require_intact(record)
        rows = RowFile.open(record.with_suffix(".npy"))
        if rows.shape != shape:
            raise DamagedFileError(rows.path, f"it has the shape {rows.shape} instead of {shape}", "")
    except DamagedFileError as error:
        return DamagedFileError(error.path, error.fault, "it is computed anew")
    return rows


def _require_intact(record: Path, *, deep: bool = False) -> None:
    path, mend = record.with_suffix(".npy"), "delete it, it is computed anew"
    try:
        digest = FileDigest.parse(read_json(record, mend))
    except ValueError as error:
        raise DamagedFileError(record, str(error), mend) from None
    fault = file_fault(path, digest, deep=deep)
    if fault:
        raise DamagedFileError(path, fault, mend)


def _checked(
    name: str, cache: "PositionCache", num_numbers: int, sequences: Iterator[Float32[np.ndarray, "frames numbers"]]
) -> Iterator[Float32[np.ndarray, "frames numbers"]]:
    for rows, expected in zip(sequences, cache.num_frames.tolist(), strict=True):
        if rows.shape != (expected, num_numbers):
            raise ValueError(f"{name}: rows of shape {rows.shape} for a sequence of {expected} × {num_numbers}")
        yield rows
