"""The training cache: joint positions of one layout as a flat memory map, made from Parquet once.

A cache lies in `store/cache/KEY`; the key is made of the store's fingerprint, the filter, the layout, the dtype and the
joint maps of the store's skeletons, so a cache that is found is a cache that fits.
"""

import hashlib
import json
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, Int, Int32, Int64

from motionkit.console import progress
from motionkit.errors import StoreError, UsageError
from motionkit.skeleton import STANDARD_SKELETONS, Skeleton
from motionkit.skeletons.mapping import SkeletonMapError, joint_map, map_joints
from motionkit.store import files
from motionkit.store.reader import Store
from motionkit.store.row_file import RowFile
from motionkit.store.schema import CACHE_FOLDER

if TYPE_CHECKING:
    import pandas as pd

CACHE_VERSION = 1
NATIVE = "native"
INDEX_DTYPE = np.dtype(
    [
        ("sequence_index", "<i4"),
        ("num_frames", "<i4"),
        ("start_row", "<i8"),
        ("fps_numerator", "<i8"),
        ("fps_denominator", "<i8"),
    ]
)
INDEX_COLUMNS = ("sequence_index", "num_frames", "fps_numerator", "fps_denominator")


@dataclass(frozen=True)
class Skipped:
    """A sequence that the filter chose but the layout cannot hold, and why."""

    sequence_index: int
    sequence_id: str
    reason: str


@dataclass(frozen=True, eq=False)
class PositionCache:
    """Frames of N sequences one after the other; sequence n is rows [start_row[n], start_row[n] + num_frames[n]).

    `positions` is a read-only memory map [total_frames, J, 3], metres; `rows` reads single frames of the same file, and
    leaves no page of it in the process. `sequence_index` leads back to the store. Picklable: another process maps the
    same file.
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

    def __reduce__(self) -> tuple[object, ...]:
        return _load, (self.path,)

    def __repr__(self) -> str:
        return f"PositionCache({self.num_sequences} sequences, {len(self.positions)} frames, {self.layout})"


def open_cache(store: Store, *, layout: str = "smpl22", where: str | None = None) -> PositionCache:
    """The cache of the sequences for which the SQL condition `where` holds, in the layout; built where it is missing.

    Layouts: `smpl22`, `kit21`, and `native` for stores (or filters) with one number of joints. Two processes may ask at
    once: one builds, the other waits. Raises `UsageError` for an unknown layout, bad SQL, or a choice that is empty or
    cannot be held; `StoreError` where the disk is too small.
    """
    if layout != NATIVE and layout not in STANDARD_SKELETONS:
        raise UsageError(f"there is no layout {layout!r}: {', '.join(STANDARD_SKELETONS)} or {NATIVE}")
    maps = _skeleton_maps(store.skeletons, layout)
    folder = store.path / CACHE_FOLDER
    target = folder / _key(store, layout, where, maps)
    if not (target / "cache.json").exists():
        folder.mkdir(exist_ok=True)
        with files.exclusive_lock(folder / ".builder.lock", busy=None):
            if not (target / "cache.json").exists():
                _remove_stale(folder, store.fingerprint)
                _build(store, layout, where, maps, target)
    return _load(target)


@dataclass(frozen=True)
class _SkeletonMap:
    """How one skeleton gets into a layout: the fault where it does not, else a digest of the map."""

    fault: str
    digest: str
    num_joints: int
    uses_tips: bool


def _skeleton_maps(skeletons: dict[str, Skeleton], layout: str) -> dict[str, _SkeletonMap]:
    return {fingerprint: _skeleton_map(skeleton, layout) for fingerprint, skeleton in skeletons.items()}


def _skeleton_map(skeleton: Skeleton, layout: str) -> _SkeletonMap:
    if layout == NATIVE:
        return _SkeletonMap("", NATIVE, skeleton.num_joints, False)
    try:
        mapping = joint_map(skeleton, layout)
    except SkeletonMapError as error:
        return _SkeletonMap(str(error), "unmapped", 0, False)
    weights = (mapping.weights, mapping.tip_weights)
    digest = hashlib.sha256(repr(mapping.made_up).encode())
    for array in weights:
        digest.update(repr(array.shape).encode() + array.tobytes())
    return _SkeletonMap("", digest.hexdigest(), len(mapping.weights), bool(mapping.tip_weights.any()))


def _key(store: Store, layout: str, where: str | None, maps: dict[str, _SkeletonMap]) -> str:
    facts = {
        "version": CACHE_VERSION,
        "layout": layout,
        "where": where,
        "dtype": "float32",
        "maps": {fingerprint: each.digest for fingerprint, each in sorted(maps.items())},
    }
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
    return f"{store.fingerprint[:16]}-{layout}-{digest[:16]}"


def _remove_stale(folder: Path, fingerprint: str) -> None:
    """Remove caches of earlier states of the store, and what killed builders left; maps in use stay valid."""
    for path in folder.iterdir():
        if path.is_dir() and (path.name.startswith("building-") or not path.name.startswith(fingerprint[:16])):
            shutil.rmtree(path, ignore_errors=True)


def _build(store: Store, layout: str, where: str | None, maps: dict[str, _SkeletonMap], target: Path) -> None:
    chosen = store.columns("sequence_id", "skeleton", *INDEX_COLUMNS).loc[store.select(where)]
    if chosen.empty:
        told = f"no sequence of {store.path} satisfies {where!r}" if where else f"{store.path} is empty"
        raise UsageError(f"{told} (motionkit info --store {store.path} says what it holds)")
    faults = chosen["skeleton"].map(lambda fingerprint: maps[fingerprint].fault)
    kept = chosen[faults == ""]
    if kept.empty:
        raise UsageError(f"none of the {len(chosen)} chosen sequences can be brought to {layout}: {faults.iloc[0]}")
    left_out = chosen[faults != ""]
    skipped = [
        Skipped(index, sequence_id, maps[fingerprint].fault)
        for index, sequence_id, fingerprint in zip(
            left_out["sequence_index"].tolist(),
            left_out["sequence_id"].tolist(),
            left_out["skeleton"].tolist(),
            strict=True,
        )
    ]
    index, num_joints = _index(kept), _num_joints(kept, maps, layout)
    shape = (int(index["num_frames"].sum(dtype=np.int64)), num_joints, 3)
    _check_disk(target.parent, shape)
    building = target.with_name(f"building-{target.name}")
    building.mkdir()
    uses_tips = any(maps[fingerprint].uses_tips for fingerprint in kept["skeleton"].unique())
    motions = store.read_many(index["sequence_index"].tolist(), rotations=uses_tips)
    with progress() as display:
        task = display.add_task(f"cache {layout}", total=len(index), note="")
        frames = (map_joints(motion, layout) for motion in display.track(motions, task_id=task))
        _write_positions(building / "positions.npy", frames, shape)
    np.save(building / "index.npy", index, allow_pickle=False)
    facts = {
        "version": CACHE_VERSION,
        "layout": layout,
        "where": where,
        "store_fingerprint": store.fingerprint,
        "skipped": [asdict(each) for each in skipped],
    }
    (building / "cache.json").write_text(json.dumps(facts, indent=2), encoding="utf-8")
    for path in building.iterdir():
        files.sync_file(path)
    building.replace(target)
    files.sync_folder(target.parent)


def _index(kept: "pd.DataFrame") -> np.ndarray:
    index = np.zeros(len(kept), INDEX_DTYPE)
    for name in INDEX_COLUMNS:
        index[name] = kept[name].to_numpy()
    index["start_row"][1:] = np.cumsum(index["num_frames"][:-1], dtype=np.int64)
    return index


def _num_joints(kept: "pd.DataFrame", maps: dict[str, _SkeletonMap], layout: str) -> int:
    counts = sorted({maps[fingerprint].num_joints for fingerprint in kept["skeleton"].unique()})
    if len(counts) > 1:
        raise UsageError(
            f"the layout {layout!r} needs one number of joints, but the chosen sequences have "
            f'{", ".join(map(str, counts))}: choose with a condition such as "num_joints = {counts[0]}"'
        )
    return counts[0]


def _check_disk(folder: Path, shape: tuple[int, ...]) -> None:
    needed, free = 4 * int(np.prod(shape, dtype=np.int64)), shutil.disk_usage(folder).free
    if needed > free:
        raise StoreError(
            f"the cache needs {needed / 1e9:.1f} GB in {folder}, where {free / 1e9:.1f} GB are free: choose fewer "
            "sequences with a condition, or free some space"
        )


def _write_positions(
    path: Path, motions: Iterator[Float32[np.ndarray, "frames joints 3"]], shape: tuple[int, ...]
) -> None:
    header = {"descr": "<f4", "fortran_order": False, "shape": shape}
    with path.open("wb") as handle:
        np.lib.format.write_array_header_1_0(handle, header)
        for positions in motions:
            handle.write(np.ascontiguousarray(positions, dtype="<f4").data)


def _load(path: Path) -> PositionCache:
    facts = json.loads((path / "cache.json").read_text(encoding="utf-8"))
    index = np.load(path / "index.npy", allow_pickle=False)
    columns = {name: np.ascontiguousarray(index[name]) for name in INDEX_DTYPE.names or ()}
    # A plain array over the map: views of np.memmap cost microseconds each.
    positions = np.load(path / "positions.npy", mmap_mode="r", allow_pickle=False).view(np.ndarray)
    return PositionCache(
        path=path,
        layout=facts["layout"],
        where=facts["where"],
        store_fingerprint=facts["store_fingerprint"],
        positions=positions,
        rows=RowFile.open(path / "positions.npy"),
        skipped=tuple(Skipped(**each) for each in facts["skipped"]),
        **columns,
    )
