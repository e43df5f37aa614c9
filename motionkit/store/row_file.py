"""Rows of a .npy file, read when they are asked for."""

import os
import weakref
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int64

from motionkit.errors import StoreError


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
        """The rows of a .npy file; raises `StoreError` for one that is not of little-endian float32 in C order."""
        with path.open("rb") as file:
            try:
                version = np.lib.format.read_magic(file)
                shape, in_columns, dtype = np.lib.format.read_array_header_1_0(file)
            except ValueError as error:
                raise StoreError(f"{path} is not a .npy file ({error}): delete it, it is made anew") from None
            if version != (1, 0) or in_columns or dtype != np.dtype("<f4") or not shape:
                raise StoreError(f"{path} holds {dtype} {shape}, not rows of float32: delete it, it is made anew")
            return cls(path, shape, file.tell())

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
