"""Builds a training cache from Parquet: sequences that fit a layout, with positions streamed into one file."""

import hashlib
import io
import json
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motionkit.core.checksums import FileDigest, sha256_of, write_json
from motionkit.core.errors import StoreError, UsageError
from motionkit.core.files import write_whole
from motionkit.core.progress import tracked
from motionkit.core.skeleton import Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map, map_joints
from motionkit.store.cache.folder import (
    CACHE_FILE,
    CACHE_VERSION,
    INDEX_FILE,
    POSITIONS_FILE,
    cache_name,
    mark,
)
from motionkit.store.cache.row_file import write_rows
from motionkit.store.reader import Store

if TYPE_CHECKING:
    import pandas as pd

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
    """A selected sequence that cannot be mapped to the layout, and why."""

    sequence_index: int
    sequence_id: str
    reason: str


@dataclass(frozen=True)
class SkeletonMap:
    """A skeleton's mapping to a layout: an error message, or a digest of the map."""

    fault: str
    digest: str
    num_joints: int
    uses_tips: bool


@dataclass(frozen=True, eq=False)
class Wanted:
    """The inputs of a cache: a store's sequences that match `where`, a layout, the skeletons' maps."""

    store: Store
    layout: str
    where: str | None
    maps: dict[str, SkeletonMap]

    @classmethod
    def of(cls, store: Store, layout: str, where: str | None) -> "Wanted":
        """All that a cache depends on."""
        maps = {fingerprint: _skeleton_map(skeleton, layout) for fingerprint, skeleton in store.skeletons.items()}
        return cls(store, layout, where, maps)

    @property
    def name(self) -> str:
        """Name of the cache's folder: equal for equal inputs."""
        facts = {
            "version": CACHE_VERSION,
            "layout": self.layout,
            "where": self.where,
            "dtype": "float32",
            "maps": {fingerprint: each.digest for fingerprint, each in sorted(self.maps.items())},
        }
        digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
        return cache_name(self.store.fingerprint, self.layout, digest)


def build(wanted: Wanted, target: Path) -> None:
    """Write the cache into the folder `target`, replacing an incomplete or damaged one; `CACHE_FILE` completes it.

    Raises `UsageError` for an empty or unsupported selection, `StoreError` if the disk is too small.
    """
    store, maps = wanted.store, wanted.maps
    kept, skipped = _chosen(wanted)
    index, num_joints = _index(kept), _num_joints(kept, wanted)
    shape = (int(index["num_frames"].sum(dtype=np.int64)), num_joints, 3)
    _check_disk(target.parent, shape)
    mark(target)
    uses_tips = any(maps[fingerprint].uses_tips for fingerprint in kept["skeleton"].unique())
    motions = store.read_many(index["sequence_index"].tolist(), rotations=uses_tips)
    counted = tracked(store.on_progress, f"cache {wanted.layout}", motions, len(index))
    frames = (map_joints(motion, wanted.layout) for motion in counted)
    positions = write_rows(target / POSITIONS_FILE, shape, frames)
    content = io.BytesIO()
    np.save(content, index, allow_pickle=False)
    write_whole(target / INDEX_FILE, content.getvalue())
    digests = {
        POSITIONS_FILE: positions,
        INDEX_FILE: FileDigest(sha256_of(target / INDEX_FILE), len(content.getvalue())),
    }
    facts = {
        "version": CACHE_VERSION,
        "layout": wanted.layout,
        "where": wanted.where,
        "store_fingerprint": store.fingerprint,
        "skipped": [asdict(each) for each in skipped],
        "files": {name: asdict(digest) for name, digest in digests.items()},
    }
    write_json(target / CACHE_FILE, facts)


def _skeleton_map(skeleton: Skeleton, layout: str) -> SkeletonMap:
    if layout == NATIVE:
        return SkeletonMap("", NATIVE, skeleton.num_joints, False)
    try:
        mapping = joint_map(skeleton, layout)
    except SkeletonMapError as error:
        return SkeletonMap(str(error), "unmapped", 0, False)
    weights = (mapping.weights, mapping.tip_weights)
    digest = hashlib.sha256(repr(mapping.made_up).encode())
    for array in weights:
        digest.update(repr(array.shape).encode() + array.tobytes())
    return SkeletonMap("", digest.hexdigest(), len(mapping.weights), bool(mapping.tip_weights.any()))


def _chosen(wanted: Wanted) -> tuple["pd.DataFrame", list[Skipped]]:
    """Rows of the sequences in the cache, and of those left out."""
    store, where, maps = wanted.store, wanted.where, wanted.maps
    chosen = store.columns("sequence_id", "skeleton", *INDEX_COLUMNS).loc[store.select_some(where)]
    faults = chosen["skeleton"].map(lambda fingerprint: maps[fingerprint].fault)
    kept = chosen[faults == ""]
    if kept.empty:
        raise UsageError(
            f"none of the {len(chosen)} chosen sequences can be brought to {wanted.layout}: {faults.iloc[0]}"
        )
    left_out = chosen[faults != ""]
    columns = [left_out[name].tolist() for name in ("sequence_index", "sequence_id", "skeleton")]
    skipped = [
        Skipped(index, sequence_id, maps[fingerprint].fault)
        for index, sequence_id, fingerprint in zip(*columns, strict=True)
    ]
    return kept, skipped


def _index(kept: "pd.DataFrame") -> np.ndarray:
    index = np.zeros(len(kept), INDEX_DTYPE)
    for name in INDEX_COLUMNS:
        index[name] = kept[name].to_numpy()
    index["start_row"][1:] = np.cumsum(index["num_frames"][:-1], dtype=np.int64)
    return index


def _num_joints(kept: "pd.DataFrame", wanted: Wanted) -> int:
    counts = sorted({wanted.maps[fingerprint].num_joints for fingerprint in kept["skeleton"].unique()})
    if len(counts) > 1:
        raise UsageError(
            f"the layout {wanted.layout!r} needs one number of joints, but the chosen sequences have "
            f'{", ".join(map(str, counts))}: choose with a condition such as "num_joints = {counts[0]}"'
        )
    return counts[0]


def _check_disk(folder: Path, shape: tuple[int, ...]) -> None:
    needed, free = 4 * int(np.prod(shape, dtype=np.int64)), shutil.disk_usage(folder).free
    if needed > free:
        raise StoreError(
            f"the cache needs {needed / 1e9:.1f} GB in {folder}, where {free / 1e9:.1f} GB are free: choose fewer "
            "sequences with a condition, free some space, or name another folder with MOTIONKIT_CACHE"
        )
