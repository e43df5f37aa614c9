"""Stores: damaged tables, parts and manifests, signed again, so that what lies behind the checksums is reached."""

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
from motionkit.core.sealed import CHECKSUM, sealed
from motionkit.errors import MotionkitError, StoreError
from motionkit.motion import Caption, Motion
from motionkit.skeleton import KIT21, SMPL22
from motionkit.store import Store
from motionkit.store.cache import open_cache
from motionkit.store.quality_report import report_quality
from motionkit.store.schema import CACHE_FOLDER, MANIFEST_FILE
from motionkit.store.summary import summarise
from motionkit.store.validate import faults
from motionkit.store.writer import StoreWriter
from motionkit.timegrid import TimeGrid
from tests.motionkit.formats.every_format import bodies

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
    """Open it, read all of it, and build a cache; what `validate` calls intact has to be read without complaint."""
    found = list(faults(folder))
    try:
        _read_all(Store.open(folder))
    except MotionkitError as error:
        assert found, f"validate finds nothing, but reading says: {error}"
        raise
    if found:
        raise StoreError(found[0])


def _read_all(store: Store) -> None:
    _ = store.sequences, store.skeletons
    for motion in store.read_many(store.select()):
        assert np.isfinite(motion.joint_positions).all(), "a number that is not finite was read"
        assert 1 <= motion.fps <= 10_000, f"{motion.fps} fps were read"
    summarise(store)
    report_quality(store)
    store.query("SELECT sequence_id, fps, len(captions) FROM sequences WHERE num_frames > 0 ORDER BY 1")
    cache = open_cache(store, layout="smpl22")
    for sequence in range(cache.num_sequences):
        assert np.isfinite(cache.sequence_positions(sequence)).all()


def signed(victim: Path, damaged: bytes) -> bytes:
    """The new content of a file, after the store's manifest has been given its checksum, size and number of rows."""
    if victim.name == MANIFEST_FILE:
        return _sealed(damaged)
    store = victim.parents[1] if victim.parent.name == "segments" else victim.parent
    _sign(store, victim.relative_to(store).as_posix(), damaged)
    return damaged


def _sealed(damaged: bytes) -> bytes:
    try:
        document = json.loads(damaged)
        return json.dumps(sealed(document)).encode() if CHECKSUM in document else damaged
    except (ValueError, RecursionError, TypeError, AttributeError):
        return damaged


def _sign(store: Path, name: str, content: bytes) -> None:
    manifest = json.loads((store / MANIFEST_FILE).read_bytes())
    entry = manifest["files"][name]
    entry["sha256"], entry["num_bytes"] = hashlib.sha256(content).hexdigest(), len(content)
    with suppress(pa.ArrowException, OSError):
        entry["num_rows"] = pq.ParquetFile(io.BytesIO(content)).metadata.num_rows
    text = json.dumps(sealed(manifest) if CHECKSUM in manifest else manifest, indent=2)
    (store / MANIFEST_FILE).write_text(f"{text}\n")


def restored(store: Path) -> None:
    """The manifest of the undamaged files again, and no cache."""
    shutil.rmtree(store / CACHE_FOLDER, ignore_errors=True)
    manifest = json.loads((store / MANIFEST_FILE).read_bytes())
    for name in manifest["files"]:
        content = (store / name).read_bytes()
        if hashlib.sha256(content).hexdigest() != manifest["files"][name]["sha256"]:
            _sign(store, name, content)


def targets() -> Iterator[Target]:
    """All of them."""
    yield Target("store-tables", (write_store,), use_store, TABLES, signed, restored)
    yield Target("store-parts", (write_store,), use_store, named("part-*.parquet"), signed, restored)
