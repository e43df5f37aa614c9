"""The training cache: joint positions of one layout as a flat memory map, built from Parquet once.

A cache is a folder in `store/cache`, or in the folder that MOTIONKIT_CACHE names. Its name has a digest of all that it
depends on: the store's fingerprint, the condition, the layout and the joint maps of the store's skeletons. It appears
whole, and caches of other states of the store are deleted when one is built. It may be deleted at any time.
"""

import errno
import hashlib
import json
import math
import os
import re
import shutil
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np

from motionkit.core.errors import DamagedFileError, StoreError, UsageError
from motionkit.core.files import exclusive_lock, read_json, whole_file, whole_folder, write_json
from motionkit.core.progress import tracked, warn
from motionkit.core.shapes import Float32, Int, Int32, Int64
from motionkit.core.skeleton import STANDARD_SKELETONS, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map, map_joints
from motionkit.store.reader import Store
from motionkit.store.schema import CACHE_FOLDER

# Raised when a cache's files or their content change.
VERSION = 3
FACTS_FILE, INDEX_FILE, POSITIONS_FILE = "cache.json", "index.npy", "positions.npy"
NATIVE = "native"
INDEX = np.dtype(
    [
        ("sequence_index", "<i4"),
        ("num_frames", "<i4"),
        ("start_row", "<i8"),
        ("fps_numerator", "<i8"),
        ("fps_denominator", "<i8"),
    ]
)
_LOCK_FILE = ".builder.lock"
_NAME = re.compile(r"[0-9a-f]{16}-[a-z0-9]+-[0-9a-f]{16}")
_NOT_WRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM)
_ADVICE = "delete its folder, it is built again"


@dataclass(frozen=True)
class Skipped:
    """A selected sequence that cannot be mapped to the layout, and why."""

    sequence_index: int
    sequence_id: str
    reason: str


@dataclass(frozen=True, eq=False)
class RowFile:
    """A float32 array of `shape` whose rows are read from a .npy file by their numbers: `rows[numbers]`.

    Unlike a memory map it leaves no page of the file in the process, however many rows are read, so a training's
    memory is that of its batches. Picklable: another process opens the same file.
    """

    path: Path
    shape: tuple[int, ...]
    first_byte: int

    @classmethod
    def open(cls, path: Path) -> "RowFile":
        """The rows of a .npy file; raises `DamagedFileError` for one that is not of `<f4` in C order, or is cut."""
        with path.open("rb") as file:
            try:
                np.lib.format.read_magic(file)
                shape, in_columns, dtype = np.lib.format.read_array_header_1_0(file)
            except ValueError as error:
                raise DamagedFileError(path, f"it is no .npy file: {error}", _ADVICE) from None
            first_byte = file.tell()
            num_bytes = file.seek(0, os.SEEK_END)
        if in_columns or dtype != np.dtype("<f4") or num_bytes != first_byte + 4 * math.prod(shape):
            raise DamagedFileError(path, f"its {num_bytes:,} bytes are not float32 {shape}", _ADVICE)
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
            raise StoreError(f"{self.path} has become shorter than its {len(self)} rows: {_ADVICE}")
        return np.frombuffer(content, dtype="<f4").reshape(*row.shape, *self.shape[1:])

    @cached_property
    def _descriptor(self) -> int:
        descriptor = os.open(self.path, os.O_RDONLY)
        weakref.finalize(self, os.close, descriptor)
        return descriptor

    def __reduce__(self) -> tuple[object, ...]:
        return RowFile, (self.path, self.shape, self.first_byte)


@dataclass(frozen=True, eq=False)
class PositionCache:
    """Concatenated frames of N sequences; sequence n is rows [start_row[n], start_row[n] + num_frames[n]).

    `positions` is a read-only memory map [total_frames, J, 3], metres; `rows` reads single frames of the same file
    without keeping pages in the process. `sequence_index` refers to the store. Picklable: another process maps the same
    file.
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
        num_features: int,
        compute: Callable[[], Iterable[Float32[np.ndarray, "frames features"]]],
    ) -> RowFile:
        """A file with a row of features for each row of `positions`, computed if it is missing or damaged.

        `compute` yields the sequences' rows in the cache's order, one sequence in memory at a time. `name` identifies
        the computation: a change needs another name. The file is deleted with the cache. If two processes call it at
        once, one computes and the other waits. Raises `ValueError` for rows that do not match the cache's frames,
        `StoreError` if the cache is not writable.
        """
        shape, path = (len(self.positions), num_features), self.path / f"{name}.npy"
        found = _existing_rows(path, shape)
        if found is not None:
            return found
        with writable(), exclusive_lock(self.path / f".{name}.lock", busy=None):
            found = _existing_rows(path, shape)
            if found is None:
                write_rows(path, shape, self._checked(name, num_features, compute()))
        return found or RowFile.open(path)

    def _checked(
        self, name: str, num_features: int, sequences: Iterable[Float32[np.ndarray, "frames features"]]
    ) -> Iterator[Float32[np.ndarray, "frames features"]]:
        for rows, expected in zip(sequences, self.num_frames.tolist(), strict=True):
            if rows.shape != (expected, num_features):
                raise ValueError(f"{name}: rows of shape {rows.shape} for a sequence of {expected} × {num_features}")
            yield rows

    def __reduce__(self) -> tuple[object, ...]:
        return _load, (self.path,)

    def __repr__(self) -> str:
        return f"PositionCache({self.num_sequences} sequences, {len(self.positions)} frames, {self.layout})"


def open_cache(store: Store, *, layout: str = "smpl22", where: str | None = None) -> PositionCache:
    """The cache of the sequences that match the SQL condition `where`, in the layout; built if missing.

    A damaged cache is rebuilt with a warning. Layouts: `smpl22`, `kit21`, and `native` for stores (or filters) with one
    number of joints. If two processes call it at once, one builds and the other waits. Raises `UsageError` for an
    unknown layout, bad SQL, or an empty or unsupported selection; `StoreError` if the disk is too small or not
    writable.
    """
    if layout != NATIVE and layout not in STANDARD_SKELETONS:
        raise UsageError(f"there is no layout {layout!r}: {', '.join(STANDARD_SKELETONS)} or {NATIVE}")
    maps = {fingerprint: _layout_map(skeleton, layout) for fingerprint, skeleton in store.skeletons.items()}
    facts = {"version": VERSION, "layout": layout, "where": where, "store_fingerprint": store.fingerprint}
    described = json.dumps({**facts, "maps": {name: each.digest for name, each in maps.items()}}, sort_keys=True)
    key = hashlib.sha256(described.encode()).hexdigest()
    root = cache_root(store.path, store.fingerprint)
    path = root / f"{store.fingerprint[:16]}-{layout}-{key[:16]}"
    if (found := _existing_cache(path)) is not None:
        return found
    with writable():
        root.mkdir(parents=True, exist_ok=True)
        with exclusive_lock(root / _LOCK_FILE, busy=None):
            found = _existing_cache(path)  # another process may have built it in between
            if found is None:
                _remove_stale(root, store.fingerprint)
                if path.is_dir():
                    shutil.rmtree(path)
                _build(path, store, where, layout, maps, facts)
    return found or _load(path)


def cache_bytes(store: Path, fingerprint: str) -> int:
    """Bytes of all caches of a store, those of its earlier states in the store included."""
    folders = _folders(cache_root(store, fingerprint))
    return sum(path.lstat().st_size for folder in folders for path in folder.rglob("*"))


def remove_stale_caches(store: Path, fingerprint: str) -> None:
    """Remove the caches of other states of the store inside it, when no builder is running."""
    root = store / CACHE_FOLDER
    if _folders(root):
        with exclusive_lock(root / _LOCK_FILE, busy=None):
            _remove_stale(root, fingerprint)


@contextmanager
def writable() -> Iterator[None]:
    """Raise `StoreError` that names MOTIONKIT_CACHE if a cache is not writable in the block."""
    try:
        yield
    except OSError as error:
        if error.errno not in _NOT_WRITABLE:
            raise
        raise StoreError(
            f"the training cache cannot be written ({error}): name a folder for caches with MOTIONKIT_CACHE"
        ) from None


def write_rows(path: Path, shape: tuple[int, ...], blocks: Iterable[Float32[np.ndarray, "..."]]) -> None:
    """Write a float32 .npy file of `shape` that appears when it is complete; `blocks` are its rows in order.

    Raises `ValueError` where they are not as many or not of that shape, and `OSError` that names the file.
    """
    num_rows = 0
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
        for block in blocks:
            if block.shape[1:] != shape[1:]:
                raise ValueError(f"{path.name}: rows of shape {block.shape[1:]}, expected {shape[1:]}")
            file.write(np.ascontiguousarray(block, dtype="<f4").data)
            num_rows += len(block)
        if num_rows != shape[0]:
            raise ValueError(f"{path.name}: {num_rows} rows, expected {shape[0]}")


@dataclass(frozen=True)
class _LayoutMap:
    """A skeleton's mapping to a layout: the reason why there is none, or what identifies it."""

    fault: str
    digest: str
    num_joints: int
    uses_tips: bool


def _layout_map(skeleton: Skeleton, layout: str) -> _LayoutMap:
    if layout == NATIVE:
        return _LayoutMap("", NATIVE, skeleton.num_joints, False)
    try:
        mapping = joint_map(skeleton, layout)
    except SkeletonMapError as error:
        return _LayoutMap(str(error), "unmapped", 0, False)
    digest = hashlib.sha256(repr(mapping.made_up).encode())
    for array in (mapping.weights, mapping.tip_weights):
        digest.update(repr(array.shape).encode() + array.tobytes())
    return _LayoutMap("", digest.hexdigest(), len(mapping.weights), bool(mapping.tip_weights.any()))


def _build(
    path: Path, store: Store, where: str | None, layout: str, maps: dict[str, _LayoutMap], facts: dict[str, object]
) -> None:
    columns = store.columns("sequence_id", "skeleton", *(name for name in INDEX.names or () if name != "start_row"))
    chosen = columns.loc[store.select_some(where)]
    faults = chosen["skeleton"].map(lambda fingerprint: maps[fingerprint].fault)
    kept, left_out = chosen[faults == ""], chosen[faults != ""]
    if kept.empty:
        raise UsageError(f"none of the {len(chosen)} chosen sequences can be brought to {layout}: {faults.iloc[0]}")
    used = [maps[fingerprint] for fingerprint in kept["skeleton"].unique()]
    counts = sorted({each.num_joints for each in used})
    if len(counts) > 1:
        raise UsageError(
            f"the layout {layout!r} needs one number of joints, but the chosen sequences have "
            f'{", ".join(map(str, counts))}: choose with a condition such as "num_joints = {counts[0]}"'
        )
    index = np.zeros(len(kept), INDEX)
    for name in INDEX.names or ():
        if name != "start_row":
            index[name] = kept[name].to_numpy()
    index["start_row"][1:] = np.cumsum(index["num_frames"][:-1], dtype=np.int64)
    shape = (int(index["num_frames"].sum(dtype=np.int64)), counts[0], 3)
    needed, free = 4 * math.prod(shape), shutil.disk_usage(path.parent).free
    if needed > free:
        raise StoreError(
            f"the cache needs {needed / 1e9:.1f} GB in {path.parent}, where {free / 1e9:.1f} GB are free: choose fewer "
            "sequences with a condition, free some space, or name another folder with MOTIONKIT_CACHE"
        )
    identity = (left_out[name].tolist() for name in ("sequence_index", "sequence_id", "skeleton"))
    skipped = [
        asdict(Skipped(number, sequence_id, maps[fingerprint].fault))
        for number, sequence_id, fingerprint in zip(*identity, strict=True)
    ]
    # Tips of bones are computed from rotations.
    motions = store.read_many(index["sequence_index"].tolist(), rotations=any(each.uses_tips for each in used))
    counted = tracked(store.on_progress, f"cache {layout}", motions, len(index))
    with whole_folder(path) as folder:
        write_rows(folder / POSITIONS_FILE, shape, (map_joints(motion, layout) for motion in counted))
        np.save(folder / INDEX_FILE, index, allow_pickle=False)
        write_json(folder / FACTS_FILE, {**facts, "skipped": skipped})


def _existing_cache(path: Path) -> PositionCache | None:
    try:
        return _load(path) if path.is_dir() else None
    except DamagedFileError as error:
        warn(f"{error.path} is damaged ({error.fault}): the cache is built again from the store")
        return None


def _existing_rows(path: Path, shape: tuple[int, int]) -> RowFile | None:
    if not path.exists():
        return None
    try:
        rows = RowFile.open(path)
        if rows.shape == shape:
            return rows
        fault = f"it has the shape {rows.shape} instead of {shape}"
    except DamagedFileError as error:
        fault = error.fault
    warn(f"{path} is damaged ({fault}): it is computed again")
    return None


def _load(path: Path) -> PositionCache:
    """Open a cache; raises `DamagedFileError` where its files are incomplete or do not belong together."""
    try:
        facts = read_json(path / FACTS_FILE, _ADVICE)
        # A map of the file: nothing is allocated by what its header says.
        index = np.load(path / INDEX_FILE, mmap_mode="r", allow_pickle=False)
        rows = RowFile.open(path / POSITIONS_FILE)
        columns = {name: np.ascontiguousarray(index[name]) for name in INDEX.names or ()}
        skipped = tuple(Skipped(**each) for each in facts["skipped"])
        layout, where, fingerprint = (facts[name] for name in ("layout", "where", "store_fingerprint"))
    except FileNotFoundError as error:
        raise DamagedFileError(Path(error.filename or path), "it is missing", _ADVICE) from None
    except (KeyError, TypeError, ValueError, IndexError, EOFError) as error:
        raise DamagedFileError(path, f"{type(error).__name__}: {error}", _ADVICE) from None
    if len(rows) != int(columns["num_frames"].sum(dtype=np.int64)):
        raise DamagedFileError(rows.path, f"its {len(rows):,} rows are not those of its index", _ADVICE)
    # A plain array over the map: views of np.memmap cost microseconds each.
    positions = np.memmap(rows.path, "<f4", "r", rows.first_byte, rows.shape).view(np.ndarray)
    return PositionCache(path, layout, where, fingerprint, positions, rows, skipped=skipped, **columns)


def _remove_stale(root: Path, fingerprint: str) -> None:
    """Remove caches of other states of the store; open memory maps stay valid."""
    for folder in _folders(root):
        if not folder.name.startswith(f"{fingerprint[:16]}-"):
            shutil.rmtree(folder)


def cache_root(store: Path, fingerprint: str) -> Path:
    """The folder of a store's caches: `cache` in it, or `fingerprint` in the folder that MOTIONKIT_CACHE names."""
    elsewhere = os.environ.get("MOTIONKIT_CACHE")
    return Path(elsewhere, fingerprint) if elsewhere else store / CACHE_FOLDER


def _folders(root: Path) -> list[Path]:
    """The folders below `root` that have a cache's name; links are left alone."""
    if not root.is_dir() or root.is_symlink():
        return []
    entries = (Path(entry) for entry in os.scandir(root) if entry.is_dir(follow_symlinks=False))
    return sorted(folder for folder in entries if _NAME.fullmatch(folder.name.removesuffix(".partial")))
