"""Numbers of every frame that follow from a cache's sequences, computed once and kept beside its positions."""

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float32

from motionkit.store import files
from motionkit.store.cache import PositionCache
from motionkit.store.row_file import RowFile


def derived_rows(
    cache: PositionCache,
    name: str,
    num_numbers: int,
    compute: Callable[[], Iterator[Float32[np.ndarray, "frames numbers"]]],
) -> RowFile:
    """A file with a row of numbers for each row of `cache.positions`, made where it is missing.

    `compute` gives the sequences' rows in the cache's order, one sequence in memory at a time. `name` stands for how
    they are computed: a change of that needs another name. The file goes when the cache goes. Two processes may ask at
    once: one computes, the other waits. Raises `ValueError` where the rows are not those of the cache's frames.
    """
    path = cache.path / f"{name}.npy"
    if not path.exists():
        with files.exclusive_lock(cache.path / f".{name}.lock", busy=None):
            if not path.exists():
                _write(cache, name, num_numbers, compute())
    return RowFile.open(path)


def _write(
    cache: PositionCache, name: str, num_numbers: int, sequences: Iterator[Float32[np.ndarray, "frames numbers"]]
) -> None:
    partial = cache.path / f"{name}.partial"
    with partial.open("wb") as handle:
        shape = (len(cache.positions), num_numbers)
        np.lib.format.write_array_header_1_0(handle, {"descr": "<f4", "fortran_order": False, "shape": shape})
        for rows, expected in zip(sequences, cache.num_frames.tolist(), strict=True):
            if rows.shape != (expected, num_numbers):
                raise ValueError(f"{name}: rows of shape {rows.shape} for a sequence of {expected} × {num_numbers}")
            handle.write(np.ascontiguousarray(rows, dtype="<f4").data)
    files.sync_file(partial)
    partial.replace(cache.path / f"{name}.npy")
