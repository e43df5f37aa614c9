"""Stores: damaged tables, parts and manifests with updated checksums, to reach the code behind the checks."""

import hashlib
import io
import json
import shutil
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.trust.fuzz.target import Target, named
from motionkit.core.errors import MotionkitError, StoreError
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import KIT21, SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store
from motionkit.store.cache import open_cache
from motionkit.store.reports import report_quality, summarise
from motionkit.store.schema import CACHE_FOLDER, MANIFEST_FILE, MOTIONS_FOLDER
from motionkit.store.validate import faults
from motionkit.store.writer import StoreWriter
from tests.helpers.every_format import bodies

TABLES = named("manifest.json", "sequences.parquet", "skeletons.parquet")


def write_store(folder: Path) -> None:
    """Three takes, one with rotations, one of another skeleton."""
    rotations = np.zeros((40, 22, 4), np.float32)
    rotations[..., 0] = 1.0
    facts = {"split": "train", "action": "walk", "captions": (Caption("walks"), Caption("turns", 0.2, 0.5))}
    with StoreWriter.create(folder) as writer:
        grid = TimeGrid(Fraction(30000, 1001), 300)
        writer.add(Motion(bodies(300, 22), SMPL22, grid, sequence_id="a/1", **facts))  # type: ignore[arg-type]
        turned = {"local_rotations": rotations, "root_translation": np.zeros((40, 3), np.float32)}
        writer.add(Motion(bodies(40, 22), SMPL22, TimeGrid(Fraction(60), 40), sequence_id="a/2", **turned))
        writer.add(Motion(bodies(9, 21), KIT21, TimeGrid(Fraction(12), 9), sequence_id="b"))


def use_store(folder: Path) -> None:
    """Open it, read all of it, and build a cache; what `validate` calls intact must be read without error."""
    found = list(faults(folder))
    try:
        _read_all(Store.open(folder))
    except MotionkitError as error:
        assert found, f"validate finds nothing, but reading says: {error}"
        raise
    except ImplausibleError:
        # Only `validate` checks every number.
        if not found:
            raise
    if found:
        raise StoreError(found[0])


class ImplausibleError(Exception):
    """What was read is no motion."""


def _read_all(store: Store) -> None:
    _ = store.sequences, store.skeletons
    for motion in store.read_many(store.select()):
        if not np.isfinite(motion.joint_positions).all() or not 1 <= motion.fps <= 10_000:
            raise ImplausibleError(f"{motion.sequence_id} at {motion.fps} fps, or with numbers that are not finite")
    summarise(store)
    report_quality(store)
    store.query("SELECT sequence_id, fps, len(captions) FROM sequences WHERE num_frames > 0 ORDER BY 1")
    cache = open_cache(store, layout="smpl22")
    if not np.isfinite(cache.positions).all():
        raise ImplausibleError("a cache with numbers that are not finite")


def signed(victim: Path, damaged: bytes) -> bytes:
    """The new content of a file, after updating its checksum, size and number of rows in the store's manifest."""
    if victim.name == MANIFEST_FILE:
        return damaged
    store = victim.parents[1] if victim.parent.name == MOTIONS_FOLDER else victim.parent
    shutil.copyfile(store / MANIFEST_FILE, _kept(store))
    manifest = json.loads((store / MANIFEST_FILE).read_bytes())
    entry = manifest["files"][victim.relative_to(store).as_posix()]
    entry |= {"sha256": hashlib.sha256(damaged).hexdigest(), "num_bytes": len(damaged)}
    with suppress(pa.ArrowException, OSError, ValueError):
        entry["num_rows"] = pq.ParquetFile(io.BytesIO(damaged)).metadata.num_rows
    (store / MANIFEST_FILE).write_text(json.dumps(manifest, indent=2))
    return damaged


def restored(store: Path) -> None:
    """Restore the manifest of the undamaged files, and remove the cache."""
    shutil.rmtree(store / CACHE_FOLDER, ignore_errors=True)
    if _kept(store).exists():
        _kept(store).replace(store / MANIFEST_FILE)


def _kept(store: Path) -> Path:
    return store.with_name(f"{store.name}.{MANIFEST_FILE}")


def targets() -> Iterator[Target]:
    """All of them."""
    yield Target("store-tables", (write_store,), use_store, TABLES, signed, restored)
    yield Target("store-parts", (write_store,), use_store, named("part-*.parquet"), signed, restored)
