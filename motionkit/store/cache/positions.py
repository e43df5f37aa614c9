"""The training cache: joint positions of one layout as a flat memory map, built from Parquet once.

A cache is `store/cache/KEY`, or in the folder that MOTIONKIT_CACHE names; the key is a hash of the store's fingerprint,
the filter, the layout, the dtype and the joint maps of the store's skeletons. `cache.json` holds the digests of its
other files, which are compared when it is opened.
"""

import zipfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Int, Int32, Int64

from motionkit.core.checksums import FileDigest, file_fault, read_json, write_json
from motionkit.core.errors import DamagedFileError, StoreError, UsageError
from motionkit.core.files import exclusive_lock, require_no_link, require_regular
from motionkit.core.progress import warn
from motionkit.core.skeleton import STANDARD_SKELETONS
from motionkit.store.cache.build import INDEX_DTYPE, NATIVE, Skipped, Wanted, build
from motionkit.store.cache.folder import (
    CACHE_FILE,
    INDEX_FILE,
    POSITIONS_FILE,
    building,
    cache_root,
    caches_of,
    is_cache,
    remove_cache,
    remove_stale,
    writable,
)
from motionkit.store.cache.row_file import RowFile, derived_faults, find_derived, write_rows
from motionkit.store.codec import numbers_of
from motionkit.store.reader import Store

_MEND = "delete its folder, it is made anew"


@dataclass(frozen=True, eq=False)
class PositionCache:
    """Concatenated frames of N sequences; sequence n is rows [start_row[n], start_row[n] + num_frames[n]).

    `positions` is a read-only memory map [total_frames, J, 3], metres; `rows` reads single frames of the same file
    without keeping pages in the process. `sequence_index` refers to the store. Picklable: another process maps the same
    file, without checking its digest.
    """

    path: Path
    layout: str
    where: str | None
    store_fingerprint: str
    positions: Float32[np.ndarray, "total_frames joints 3"]
    rows: RowFile
    sequence_index: Int32[np.ndarray, "sequences"]
    start_row: Int64[np.ndarray, "sequences"]
    num_frames: Int32[np.ndarray, "sequences"]
    fps_numerator: Int64[np.ndarray, "sequences"]
    fps_denominator: Int64[np.ndarray, "sequences"]
    skipped: tuple[Skipped, ...]

    @property
    def num_sequences(self) -> int:
        """Number of sequences N."""
        return len(self.sequence_index)

    @property
    def num_joints(self) -> int:
        """Number of joints J of the layout."""
        return int(self.positions.shape[1])

    def exact_fps(self, sequence: int | np.integer) -> Fraction:
        """The framerate of the n-th sequence of the cache."""
        return Fraction(int(self.fps_numerator[sequence]), int(self.fps_denominator[sequence]))

    def sequence_positions(self, sequence: int | np.integer) -> Float32[np.ndarray, "frames joints 3"]:
        """All frames of the n-th sequence of the cache, metres: a view, nothing is copied."""
        start = self.start_row[sequence]
        return self.positions[start : start + self.num_frames[sequence]]

    def gather_clips(
        self,
        sequence: Int[np.ndarray, "batch"],
        start_frame: Int[np.ndarray, "batch"],
        num_frames: int,
    ) -> Float32[np.ndarray, "batch frames joints 3"]:
        """Native frames [start_frame, start_frame + num_frames) of the n-th sequences of this cache, metres.

        Raises `IndexError` where a clip leaves its sequence.
        """
        if num_frames < 1:
            raise IndexError(f"a clip needs at least one frame, not {num_frames}")
        outside = (start_frame < 0) | (start_frame.astype(np.int64) + num_frames > self.num_frames[sequence])
        if outside.any():
            which = int(np.argmax(outside))
            raise IndexError(
                f"frames [{start_frame[which]}, {start_frame[which] + num_frames}) do not lie inside the "
                f"{self.num_frames[sequence[which]]} frames of the cache's sequence {sequence[which]}"
            )
        first_rows = self.start_row[sequence] + start_frame
        # Every run of num_frames rows as one overlapping view: the gather then copies each clip in one piece.
        windows = np.lib.stride_tricks.sliding_window_view(
            self.positions.reshape(-1), num_frames * self.positions[0].size
        )
        clips: Float32[np.ndarray, "batch values"] = windows[first_rows * self.positions[0].size]
        return clips.reshape(len(first_rows), num_frames, *self.positions.shape[1:])

    def derived_rows(
        self,
        name: str,
        num_numbers: int,
        compute: Callable[[], Iterator[Float32[np.ndarray, "frames numbers"]]],
    ) -> RowFile:
        """A file with a row of numbers for each row of `positions`, computed if it is missing or damaged.

        `compute` yields the sequences' rows in the cache's order, one sequence in memory at a time. `name` identifies
        the computation: a change needs another name. The file is deleted with the cache. If two processes call it at
        once, one computes and the other waits. Raises `ValueError` for rows that do not match the cache's frames,
        `StoreError` if the cache is not writable.
        """
        shape, path = (len(self.positions), num_numbers), self.path / f"{name}.npy"
        found = find_derived(self.path, name, shape)
        if isinstance(found, RowFile):
            return found
        with writable(found), exclusive_lock(self.path / f".{name}.lock", busy=None):
            found = find_derived(self.path, name, shape)
            if isinstance(found, RowFile):
                return found
            if found is not None:
                warn(str(found))
            digest = write_rows(path, shape, self._checked(name, num_numbers, compute()))
            write_json(self.path / f"{name}.json", asdict(digest))
        return RowFile.open(path)

    def _checked(
        self, name: str, num_numbers: int, sequences: Iterator[Float32[np.ndarray, "frames numbers"]]
    ) -> Iterator[Float32[np.ndarray, "frames numbers"]]:
        for rows, expected in zip(sequences, self.num_frames.tolist(), strict=True):
            if rows.shape != (expected, num_numbers):
                raise ValueError(f"{name}: rows of shape {rows.shape} for a sequence of {expected} × {num_numbers}")
            yield rows

    def __reduce__(self) -> tuple[object, ...]:
        return _opened_again, (self.path,)

    def __repr__(self) -> str:
        return f"PositionCache({self.num_sequences} sequences, {len(self.positions)} frames, {self.layout})"


def open_cache(store: Store, *, layout: str = "smpl22", where: str | None = None) -> PositionCache:
    """The cache of the sequences that match the SQL condition `where`, in the layout; built if missing.

    A damaged cache is rebuilt with a warning. Layouts: `smpl22`, `kit21`, and `native` for stores (or filters) with one
    number of joints. If two processes call it at once, one builds and the other waits. Raises `UsageError` for an
    unknown layout, bad SQL, or an empty or unsupported selection; `StoreError` if the disk is too small or not
    writable; `LinkError` if the folder of caches is a symbolic link.
    """
    if layout != NATIVE and layout not in STANDARD_SKELETONS:
        raise UsageError(f"there is no layout {layout!r}: {', '.join(STANDARD_SKELETONS)} or {NATIVE}")
    wanted = Wanted.of(store, layout, where)
    root = cache_root(store.path, store.fingerprint)
    target = root / wanted.name
    found = _find(target, wanted)
    if isinstance(found, PositionCache):
        return found
    with building(root, found):
        found = _find(target, wanted)  # another process may have built it in between
        if isinstance(found, PositionCache):
            return found
        if found is not None:
            warn(str(found))
        remove_stale(root, store.fingerprint)
        try:
            build(wanted, target)
        except BaseException:
            if target.is_dir() and is_cache(target):
                remove_cache(target)
            raise
    return _load(target, check=True)


def cache_faults(store: Path, fingerprint: str) -> Iterator[str]:
    """One line for each fault of the caches of a state of a store, of all their bytes whatever their sizes."""
    root = cache_root(store, fingerprint)
    for folder in caches_of(root, fingerprint):
        try:
            _load(folder, check=True, deep=True)
        except DamagedFileError as error:
            yield str(error)
        for fault in derived_faults(folder):
            yield str(fault)


def _find(target: Path, wanted: Wanted) -> PositionCache | DamagedFileError | None:
    """The cache in a folder, or its damage, or None if there is none."""
    require_no_link(target, "delete the link")
    if not (target / CACHE_FILE).exists():
        return None
    try:
        cache = _load(target, check=True)
        _require_wanted(cache, wanted)
    except DamagedFileError as error:
        return DamagedFileError(error.path, error.fault, "the cache is made anew from the store")
    return cache


def _opened_again(path: Path) -> PositionCache:
    try:
        return _load(path, check=False)
    except FileNotFoundError:
        raise StoreError(f"the training cache {path} was removed, since its store has changed: start again") from None


def _load(path: Path, *, check: bool, deep: bool = False) -> PositionCache:
    facts = read_json(path / CACHE_FILE, _MEND)
    try:
        digests = {name: FileDigest.parse(facts["files"][name]) for name in (POSITIONS_FILE, INDEX_FILE)}
        skipped = tuple(Skipped(**each) for each in facts["skipped"])
        layout, where, fingerprint = (facts[name] for name in ("layout", "where", "store_fingerprint"))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DamagedFileError(path / CACHE_FILE, f"{type(error).__name__}: {error}", _MEND) from None
    for name, digest in digests.items() if check else ():
        fault = file_fault(path / name, digest, deep=deep)
        if fault:
            raise DamagedFileError(path / name, fault, _MEND)
    columns = _read_index(path / INDEX_FILE)
    rows = RowFile.open(path / POSITIONS_FILE)
    if rows.shape != (int(columns["num_frames"].sum(dtype=np.int64)), *rows.shape[1:2], 3):
        raise DamagedFileError(path / POSITIONS_FILE, f"its shape {rows.shape} is not that of its index", _MEND)
    # A plain array over the map: views of np.memmap cost microseconds each.
    positions = np.memmap(rows.path, "<f4", "r", rows.first_byte, rows.shape).view(np.ndarray)
    return PositionCache(path, layout, where, fingerprint, positions, rows, skipped=skipped, **columns)


def _read_index(path: Path) -> dict[str, Any]:
    """The columns of an index, consistent with each other."""
    require_regular(path)
    try:
        # A map of the file: nothing is allocated by what its header says.
        index = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(index, np.ndarray) or index.dtype != INDEX_DTYPE or index.ndim != 1:
            raise ValueError("it holds something else")
    except (ValueError, OverflowError, EOFError, zipfile.BadZipFile) as error:
        raise DamagedFileError(path, str(error), _MEND) from None
    columns = {name: np.ascontiguousarray(index[name]) for name in INDEX_DTYPE.names or ()}
    ends = np.cumsum(columns["num_frames"], dtype=np.int64)
    if (
        not len(index)
        or columns["num_frames"].min() < 1
        or (ends - columns["num_frames"] != columns["start_row"]).any()
    ):
        raise DamagedFileError(path, "its sequences do not follow each other", _MEND)
    return columns


def _require_wanted(cache: PositionCache, wanted: Wanted) -> None:
    """Raise `DamagedFileError` where a cache is not what its folder's name says, or not about the store's sequences."""
    store = wanted.store
    if (cache.layout, cache.where, cache.store_fingerprint) != (wanted.layout, wanted.where, store.fingerprint):
        raise DamagedFileError(cache.path / CACHE_FILE, "it is that of another cache", _MEND)
    try:
        rows = store.rows_of(cache.sequence_index)
    except StoreError as error:
        raise DamagedFileError(cache.path / INDEX_FILE, str(error), _MEND) from None
    for name in ("num_frames", "fps_numerator", "fps_denominator"):
        if not np.array_equal(numbers_of(store.sequences_table[name])[rows], getattr(cache, name)):
            raise DamagedFileError(cache.path / INDEX_FILE, f"{name} are not those of {store.path}", _MEND)
