"""The training cache: joint positions of one layout as a flat memory map, built from Parquet once.

A cache is a folder in `store/cache`, or in the folder that MOTIONKIT_CACHE names. Its name has a digest of all that it
depends on: the store's fingerprint, the condition, the layout and the joint maps of the store's skeletons. It appears
whole: `positions.npy`, and `cache.json` with the sequences' lengths and framerates. Caches of other states of the store
are deleted when one is built. It may be deleted at any time.
"""

import errno
import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import DamagedFileError, StoreError, UsageError
from motionkit.core.files import exclusive_lock, remove_entry, whole_file, write_whole
from motionkit.core.progress import tracked, warn
from motionkit.core.shapes import Float32, Int, Int32, Int64
from motionkit.core.skeleton import STANDARD_SKELETONS
from motionkit.core.skeletons.mapping import JointMap, SkeletonMapError, joint_map, map_joints
from motionkit.store.reader import Store
from motionkit.store.schema import CACHE_FOLDER

# Raised when a cache's files or their content change.
VERSION = 4
FACTS_FILE, POSITIONS_FILE = "cache.json", "positions.npy"
NATIVE = "native"
# What a cache knows of each sequence, from the store's table.
COLUMNS = {"sequence_index": np.int32, "num_frames": np.int32, "fps_numerator": np.int64, "fps_denominator": np.int64}
_LOCK_FILE = ".builder.lock"
_NAME = re.compile(r"[0-9a-f]{16}-[a-z0-9]+-[0-9a-f]{16}")
_NOT_WRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM)
_HINT = "delete its folder, it is built again"


@dataclass(frozen=True)
class Skipped:
    """A selected sequence that cannot be mapped to the layout, and why."""

    sequence_index: int
    sequence_id: str
    reason: str


@dataclass(frozen=True, eq=False)
class PositionCache:
    """Concatenated frames of N sequences; sequence n is rows [start_row[n], start_row[n] + num_frames[n]).

    `positions` is a read-only memory map [total_frames, J, 3], metres. `sequence_index` refers to the store. Picklable:
    another process maps the same file.
    """

    path: Path
    layout: str
    where: str | None
    store_fingerprint: str
    positions: Float32[np.ndarray, "total_frames joints 3"]
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

    def derived_rows(
        self,
        name: str,
        num_features: int,
        compute: Callable[[], Iterable[Float32[np.ndarray, "frames features"]]],
    ) -> Float32[np.ndarray, "total_frames features"]:
        """A memory map with a row of features for each row of `positions`, computed if its file is missing or cut.

        `compute` yields the sequences' rows in the cache's order, one sequence in memory at a time. `name` identifies
        the computation: a change needs another name. The file is deleted with the cache. If two processes call it at
        once, one computes and the other waits. Raises `ValueError` for rows that do not match the cache's frames,
        `StoreError` if the cache is not writable.
        """
        shape, path = (len(self.positions), num_features), self.path / f"{name}.npy"
        if (existing := _map(path, shape)) is not None:
            return existing
        with writable(), exclusive_lock(self.path / f".{name}.lock", busy=None):
            rows = _map(path, shape)  # another process may have computed it in between
            if rows is None:
                if path.exists():
                    warn(f"{path} is damaged: it is computed again")
                for leftover in self.path.glob(f".{path.name}.*"):  # of a killed process
                    leftover.unlink()
                rows = _write(path, shape, compute(), self.num_frames)
        return rows

    def __reduce__(self) -> tuple[object, ...]:
        return _load, (self.path,)

    def __repr__(self) -> str:
        return f"PositionCache({self.num_sequences} sequences, {len(self.positions)} frames, {self.layout})"


def open_cache(store: Store, *, layout: str = "smpl22", where: str | None = None) -> PositionCache:
    """The cache of the sequences that match the SQL condition `where`, in the layout; built if missing.

    An incomplete cache is rebuilt with a warning. Layouts: `smpl22`, `kit21`, and `native` for stores (or filters) with
    one number of joints. If two processes call it at once, one builds and the other waits. Raises `UsageError` for an
    unknown layout, bad SQL, or an empty or unsupported selection; `StoreError` if the folder is not writable.
    """
    if layout != NATIVE and layout not in STANDARD_SKELETONS:
        raise UsageError(f"there is no layout {layout!r}: {', '.join(STANDARD_SKELETONS)} or {NATIVE}")
    maps: dict[str, JointMap] = {}
    faults: dict[str, str] = {}
    for name, skeleton in () if layout == NATIVE else store.skeletons.items():
        try:
            maps[name] = joint_map(skeleton, layout)
        except SkeletonMapError as error:
            faults[name] = str(error)
    facts = {"version": VERSION, "layout": layout, "where": where, "store_fingerprint": store.fingerprint}
    described = hashlib.sha256(json.dumps(facts).encode())
    for mapping in maps.values():
        described.update(mapping.weights.tobytes() + mapping.tip_weights.tobytes() + repr(mapping.made_up).encode())
    key = described.hexdigest()
    root = cache_root(store.path, store.fingerprint)
    path = root / f"{store.fingerprint[:16]}-{layout}-{key[:16]}"
    with suppress(DamagedFileError):
        return _load(path)
    with writable():
        root.mkdir(parents=True, exist_ok=True)
        with exclusive_lock(root / _LOCK_FILE, busy=None):
            with suppress(DamagedFileError):
                return _load(path)  # another process may have built it in between
            _remove_stale(root, store.fingerprint)
            if path.is_dir():
                warn(f"{path} is damaged: the cache is built again from the store")
                shutil.rmtree(path)
            _build(path, store, where, layout, maps, faults, facts)
    return _load(path)


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


def _write(
    path: Path,
    shape: tuple[int, ...],
    sequences: Iterable[Float32[np.ndarray, "..."]],
    num_frames: Int[np.ndarray, "sequences"],
) -> Float32[np.ndarray, "..."]:
    """Write a float32 .npy file of `shape` that appears when it is complete, from the sequences; returns its map.

    Raises `ValueError` for a sequence with rows of another number or shape.
    """
    # Not through a map: a write to a map of a full disk ends the process.
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
        for rows, expected in zip(sequences, num_frames.tolist(), strict=True):
            if rows.shape != (expected, *shape[1:]):
                raise ValueError(f"{path.stem}: rows of shape {rows.shape}, expected {(expected, *shape[1:])}")
            file.write(np.ascontiguousarray(rows, dtype="<f4").data)
    written = _map(path, shape)
    assert written is not None
    return written


def _map(path: Path, shape: tuple[int, ...]) -> Float32[np.ndarray, "..."] | None:
    """A read-only memory map of a .npy file; None for one that is missing, cut, or of other numbers."""
    try:
        # A plain array over the map: views of np.memmap cost microseconds each.
        rows = np.lib.format.open_memmap(path, mode="r").view(np.ndarray)
    except (OSError, ValueError):
        return None
    return rows if rows.dtype == np.float32 and rows.shape == shape else None


def _build(
    path: Path,
    store: Store,
    where: str | None,
    layout: str,
    maps: Mapping[str, JointMap],
    faults: Mapping[str, str],
    facts: Mapping[str, object],
) -> None:
    columns = store.columns("sequence_id", "skeleton", "num_joints", *COLUMNS)
    chosen = columns.loc[store.select_some(where)]
    is_unknown = chosen["skeleton"].isin(faults)
    kept, left_out = chosen[~is_unknown], chosen[is_unknown]
    if kept.empty:
        fault = faults[str(chosen["skeleton"].iloc[0])]
        raise UsageError(f"none of the {len(chosen)} chosen sequences can be brought to {layout}: {fault}")
    is_native = layout == NATIVE
    counts = sorted(set(kept["num_joints"].tolist())) if is_native else [STANDARD_SKELETONS[layout].num_joints]
    if len(counts) > 1:
        raise UsageError(
            f"the layout {layout!r} needs one number of joints, but the chosen sequences have "
            f'{", ".join(map(str, counts))}: choose with a condition such as "num_joints = {counts[0]}"'
        )
    num_frames = kept["num_frames"].to_numpy()
    shape = (int(num_frames.sum(dtype=np.int64)), counts[0], 3)
    skipped = left_out[["sequence_index", "sequence_id"]].assign(reason=left_out["skeleton"].map(faults))
    # Tips of bones are computed from rotations.
    uses_tips = not is_native and any(maps[name].tip_weights.any() for name in kept["skeleton"].unique())
    motions = store.read_many(kept.index.tolist(), rotations=uses_tips)
    counted = tracked(store.on_progress, f"cache {layout}", motions, len(kept))
    sequences = {name: kept[name].tolist() for name in COLUMNS}
    facts = {**facts, "num_joints": counts[0], "sequences": sequences, "skipped": skipped.to_dict("records")}
    partial = path.with_name(f"{path.name}.partial")
    remove_entry(partial)  # of a killed builder
    try:
        partial.mkdir()
        _write(partial / POSITIONS_FILE, shape, (map_joints(motion, layout) for motion in counted), num_frames)
        write_whole(partial / FACTS_FILE, json.dumps(facts))
        partial.rename(path)
    finally:
        remove_entry(partial)


def _load(path: Path) -> PositionCache:
    """Open a cache; raises `DamagedFileError` where its files are missing or do not belong together."""
    try:
        facts = json.loads((path / FACTS_FILE).read_bytes())
        columns: dict[str, Any] = {name: np.array(facts["sequences"][name], dtype) for name, dtype in COLUMNS.items()}
        skipped = tuple(Skipped(**each) for each in facts["skipped"])
        described = {name: facts[name] for name in ("layout", "where", "store_fingerprint")}
        num_frames, num_joints = columns["num_frames"].astype(np.int64), int(facts["num_joints"])
    except FileNotFoundError:
        raise DamagedFileError(path / FACTS_FILE, "it is missing", _HINT) from None
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedFileError(path / FACTS_FILE, f"{type(error).__name__}: {error}", _HINT) from None
    positions = _map(path / POSITIONS_FILE, (int(num_frames.sum()), num_joints, 3))
    if positions is None:
        raise DamagedFileError(path / POSITIONS_FILE, "it is missing or cut", _HINT)
    start_row = np.cumsum(num_frames) - num_frames
    return PositionCache(path=path, positions=positions, start_row=start_row, skipped=skipped, **columns, **described)


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
