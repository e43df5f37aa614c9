"""Small motions for the drill, and summaries of a store; run in separate processes (`call:` of `process`)."""

import csv
import hashlib
import json
from fractions import Fraction
from pathlib import Path

import numpy as np

ACTIONS = ("walk", "run", "squat", "bow")
FRAMERATES = (30, 60)
COLUMNS = ("file", "fps", "action", "subject", "caption", "split")


def write_takes(folder: str, first: str, count: str, seconds: str) -> None:
    """Write takes FIRST … FIRST + COUNT − 1 of so many seconds as BVH files, with a table of captions and splits."""
    from motionkit.fields.motion_field import to_motion
    from motionkit.io.bvh import write_bvh
    from tests.helpers.analytic import analytic_motion

    path = Path(folder)
    path.mkdir(parents=True)
    with (path / "clips.csv").open("w", encoding="utf-8", newline="") as handle:
        table = csv.writer(handle, lineterminator="\n")
        table.writerow(COLUMNS)
        for number in range(int(first), int(first) + int(count)):
            action, fps = ACTIONS[number % len(ACTIONS)], FRAMERATES[number // 2 % len(FRAMERATES)]
            field = analytic_motion(action, float(seconds), number)
            write_bvh(to_motion(field, Fraction(fps)), path / f"take-{number}.bvh")
            split = "test" if number % 4 == 3 else "train"
            table.writerow(
                (f"take-{number}.bvh", fps, action, f"p{number % 3}", f"a person does a {action}", split),
            )


def build_cache(store: str) -> None:
    """Build the training cache of a store, and the statistics beside it."""
    from motionkit.store import Store
    from motionkit.store.cache import open_cache

    cache = open_cache(Store.open(store))
    print(len(cache.positions))


def read_without(store: str, name: str) -> None:
    """Open a store and its cache, remove a file, and read every frame of both."""
    from motionkit.store import Store
    from motionkit.store.cache import open_cache

    opened = Store.open(store)
    cache = open_cache(opened, where="split = 'train'")
    Path(name).unlink()
    print(content_of(opened), float(cache.positions.sum()), len(cache.positions))


def look(store: str) -> None:
    """Print a reader's view as JSON: the store's fingerprint, a digest of every motion, and `validate`'s faults."""
    from motionkit.store import Store
    from motionkit.store.schema import MANIFEST_FILE
    from motionkit.store.validate import faults

    if not (Path(store) / MANIFEST_FILE).exists():
        print(json.dumps({"fingerprint": None, "content": None, "faults": []}))
        return
    opened = Store.open(store)
    print(
        json.dumps(
            {"fingerprint": opened.fingerprint, "content": content_of(opened), "faults": list(faults(Path(store)))}
        )
    )


def content_of(store: object) -> str:
    """A digest of the content of a store's sequences, independent of its parts and indices."""
    from motionkit.store import Store

    assert isinstance(store, Store)
    found = hashlib.sha256()
    for motion in store.read_many(store.sequences_table["sequence_index"].to_pylist()):
        facts = (motion.sequence_id, motion.fps, motion.split, motion.action, motion.captions)
        found.update(repr(facts).encode() + np.ascontiguousarray(motion.joint_positions).tobytes())
    return found.hexdigest()
