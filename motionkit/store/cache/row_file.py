"""Rows of a .npy file: written in blocks, read lazily, verified by a digest."""

import hashlib
import math
import os
import weakref
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64

from motionkit.core.checksums import FileDigest, file_fault, read_json
from motionkit.core.errors import DamagedFileError, StoreError
from motionkit.core.files import require_regular, whole_file

_MEND = "delete it, it is made anew"


def write_rows(path: Path, shape: tuple[int, ...], blocks: Iterable[Float32[np.ndarray, "..."]]) -> FileDigest:
    """Write a float32 .npy file of `shape` that appears when it is complete; `blocks` are its rows in order.

    Raises `ValueError` where they are not as many or not of that shape, and `OSError` that names the file.
    """
    digest, num_rows = hashlib.sha256(), 0
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
        file.flush()
        digest.update(temporary.read_bytes())
        for block in blocks:
            if block.shape[1:] != shape[1:]:
                raise ValueError(f"{path.name}: rows of shape {block.shape[1:]}, expected {shape[1:]}")
            content = np.ascontiguousarray(block, dtype="<f4").data
            file.write(content)
            digest.update(content)
            num_rows += len(block)
        if num_rows != shape[0]:
            raise ValueError(f"{path.name}: {num_rows} rows, expected {shape[0]}")
        num_bytes = file.tell()
    return FileDigest(digest.hexdigest(), num_bytes)


@dataclass(frozen=True, eq=False)
class RowFile:
    """A float32 array of `shape` whose rows are read from a file by their numbers: `rows[numbers]`.

    Unlike a memory map it leaves no page of the file in the process, however many rows are asked for, so a training's
    memory is that of its batches. Picklable: another process opens the same file.
    """

    path: Path
    shape: tuple[int, ...]
    first_byte: int

    @classmethod
    def open(cls, path: Path) -> "RowFile":
        """The rows of a .npy file; raises `DamagedFileError` for one that is not of `<f4` in C order, or is cut."""
        require_regular(path)
        with path.open("rb") as file:
            try:
                version = np.lib.format.read_magic(file)
                shape, in_columns, dtype = np.lib.format.read_array_header_1_0(file)
            except ValueError as error:
                raise DamagedFileError(path, f"it is no .npy file: {error}", _MEND) from None
            if version != (1, 0) or in_columns or dtype != np.dtype("<f4") or not shape or min(shape) < 0:
                raise DamagedFileError(path, f"it holds {dtype} {shape}, not rows of float32", _MEND)
            first_byte = file.tell()
            if file.seek(0, os.SEEK_END) != first_byte + 4 * math.prod(shape):
                raise DamagedFileError(path, f"it does not have the bytes of float32 {shape}", _MEND)
            return cls(path, shape, first_byte)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, row: Int64[np.ndarray, "*rows"]) -> Float32[np.ndarray, "*rows_and_row"]:
        """Copies of the rows with these numbers, in their order; the caller may write to them.

        Rows that follow each other are read at once. Raises `IndexError` for a number outside [0, len), `StoreError`
        where the file has become shorter.
        """
        numbers = row.reshape(-1)
        if numbers.size and not 0 <= numbers.min() <= numbers.max() < len(self):
            wrong = int(numbers.min() if numbers.min() < 0 else numbers.max())
            raise IndexError(f"row {wrong} does not lie in [0, {len(self)}) of {self.path}")
        starts = np.flatnonzero(np.diff(numbers, prepend=-2) != 1)
        counts = np.diff(starts, append=numbers.size)
        row_bytes = 4 * int(np.prod(self.shape[1:], dtype=np.int64))
        places = (self.first_byte + row_bytes * numbers[starts]).tolist()
        # A system call a run, under a microsecond each; a map's page faults cost more as soon as pages are given back.
        file = self._descriptor
        read = [os.pread(file, size, at) for size, at in zip((row_bytes * counts).tolist(), places, strict=True)]
        content = bytearray().join(read)
        if len(content) != row_bytes * numbers.size:
            raise StoreError(f"{self.path} has become shorter than its {len(self)} rows: delete it, it is made anew")
        return np.frombuffer(content, dtype="<f4").reshape(*row.shape, *self.shape[1:])

    @cached_property
    def _descriptor(self) -> int:
        descriptor = os.open(self.path, os.O_RDONLY)
        weakref.finalize(self, os.close, descriptor)
        return descriptor

    def __reduce__(self) -> tuple[object, ...]:
        return RowFile, (self.path, self.shape, self.first_byte)


def derived_faults(folder: Path) -> Iterator[DamagedFileError]:
    """What is wrong with the derived files in a cache's folder, all their bytes compared."""
    for record in sorted(folder.glob("*.json")):
        if (folder / f".{record.stem}.lock").exists():
            try:
                _require_intact(record, deep=True)
            except DamagedFileError as error:
                yield error


def find_derived(folder: Path, name: str, shape: tuple[int, int]) -> RowFile | DamagedFileError | None:
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
